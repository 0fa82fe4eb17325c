#include "s2gs/core/gpu_info.h"

namespace s2gs {

std::string BuiltWithCuda() { return ""; }

std::vector<GpuInfo> ListGpus() { return {}; }

}  // namespace s2gs
