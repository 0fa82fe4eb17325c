#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace s2gs {

/// One GPU of this machine, as the CUDA runtime sees it.
struct GpuInfo {
  int index = 0;
  std::string name;
  int compute_major = 0;
  int compute_minor = 0;
  uint64_t memory_bytes = 0;
  bool is_usable = false;  ///< a kernel of this program ran on it and gave the right result.
  std::string problem;     ///< why it is not usable; empty otherwise.
};

/// The CUDA toolkit that this program was built with, e.g. "13.0"; empty without the CUDA backend.
std::string BuiltWithCuda();

/// All GPUs, each tried with a small kernel (about 0.3 s for the first one). The thread goes on with the one
/// that it had. Empty without the CUDA backend, a driver or a GPU; never throws.
std::vector<GpuInfo> ListGpus();

}  // namespace s2gs
