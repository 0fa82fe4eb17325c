#include "plugin/shared_options/backend_choice.h"

#include <algorithm>
#include <string>
#include <vector>

#include "s2gs/core/gpu_info.h"

namespace s2gs {
namespace {

const EnumNames<UseGpu> kUseGpuNames = {{"auto", UseGpu::kAuto}, {"0", UseGpu::kNo}, {"1", UseGpu::kYes}};

// Why the GPU of that index cannot be used; empty when it can.
std::string ProblemOf(const std::vector<GpuInfo>& gpus, int index) {
  if (BuiltWithCuda().empty()) return "this program was built without CUDA";
  const auto found =
      std::find_if(gpus.begin(), gpus.end(), [&](const GpuInfo& gpu) { return gpu.index == index; });
  if (found == gpus.end()) return "there is no GPU of index " + std::to_string(index);
  return found->is_usable ? "" : found->name + ": " + found->problem;
}

}  // namespace

OptionCheck BackendChoice::Check() const {
  if (gpu_index < 0) return OptionFault{"gpu_index", std::to_string(gpu_index), "gpu_index >= 0"};
  if (num_threads < 0) return OptionFault{"num_threads", std::to_string(num_threads), "num_threads >= 0"};
  return std::nullopt;
}

void AddBackendOptions(Options* options, BackendChoice* choice) {
  OptionGroup<BackendChoice> group = options->Fields(choice);
  group.AddEnum("use_gpu", &BackendChoice::use_gpu, kUseGpuNames,
                "compute on a GPU; auto: when there is one that works");
  group.Add("gpu_index", &BackendChoice::gpu_index, "which GPU");
  group.Add("num_threads", &BackendChoice::num_threads,
            "threads on the CPU, which results do not depend on; 0: all cores");
}

std::string GpuProblem(const BackendChoice& choice) { return ProblemOf(ListGpus(), choice.gpu_index); }

std::unique_ptr<Backend> MakeBackend(const BackendChoice& choice, Reporter& reporter) {
  std::unique_ptr<Backend> backend;
  if (choice.use_gpu == UseGpu::kNo) {
    backend = MakeCpuBackend(choice.num_threads);
  } else {
    const std::string problem = GpuProblem(choice);
    if (!problem.empty() && choice.use_gpu == UseGpu::kYes) {
      throw UserError("no GPU can be used: " + problem + ". Give --use_gpu 0 or auto to compute on the CPU");
    }
    if (!problem.empty()) reporter.Info("computing on the CPU: " + problem);
    backend = problem.empty() ? MakeCudaBackend(choice.gpu_index) : MakeCpuBackend(choice.num_threads);
  }
  const BackendInfo info = backend->Info();
  reporter.Info(std::string("backend ") + BackendName(info.kind) + ": " + info.device);
  return backend;
}

}  // namespace s2gs
