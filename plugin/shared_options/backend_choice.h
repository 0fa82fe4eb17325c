#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "plugin/cli/options.h"
#include "s2gs/backend/backend.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

enum class UseGpu : uint8_t { kAuto, kNo, kYes };

/// Where to compute; the options that every command on Gaussians has.
struct BackendChoice {
  UseGpu use_gpu = UseGpu::kAuto;
  int32_t gpu_index = 0;
  int32_t num_threads = 0;  ///< of the CPU; 0: all cores.

  OptionCheck Check() const;
};

/// Declares --use_gpu, --gpu_index and --num_threads.
void AddBackendOptions(Options* options, BackendChoice* choice);

/// Why the GPU that is chosen cannot be used; empty when it can.
std::string GpuProblem(const BackendChoice& choice);

/// Makes the backend and says which one and why. Throws UserError when a GPU is asked for and there is none.
std::unique_ptr<Backend> MakeBackend(const BackendChoice& choice, Reporter& reporter);

}  // namespace s2gs
