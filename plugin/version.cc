#include "plugin/version.h"

namespace s2gs {

std::string Version() { return S2GS_VERSION; }

std::string VersionText() {
  const std::string cuda = S2GS_CUDA_VERSION;
  return "s2gs " + Version() + " (" + (cuda.empty() ? "no CUDA" : "CUDA " + cuda) +
         (S2GS_WITH_SFM ? ", with SfM" : ", without SfM") + ", " + S2GS_BUILD_TYPE + " build)";
}

}  // namespace s2gs
