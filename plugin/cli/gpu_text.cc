#include "plugin/cli/version.h"
#include "s2gs/core/gpu_info.h"

namespace s2gs {

std::string VersionText() {
  const std::string cuda = BuiltWithCuda();
  return "s2gs " + Version() + " (" + (cuda.empty() ? "no CUDA" : "CUDA " + cuda) +
         (S2GS_WITH_SFM ? ", with SfM" : ", without SfM") + ", " + S2GS_BUILD_TYPE + " build)";
}

std::string GpuText() {
  std::string text;
  for (const GpuInfo& gpu : ListGpus()) {
    text += "GPU " + std::to_string(gpu.index) + ": " + gpu.name + ", compute capability " +
            std::to_string(gpu.compute_major) + "." + std::to_string(gpu.compute_minor) + ", " +
            std::to_string(gpu.memory_bytes >> 30) + " GiB, " +
            (gpu.is_usable ? "usable" : "not usable: " + gpu.problem) + "\n";
  }
  return text;
}

}  // namespace s2gs
