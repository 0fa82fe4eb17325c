#include "s2gs/backend.h"

namespace s2gs {

const char* BackendName(BackendKind kind) { return kind == BackendKind::kCuda ? "CUDA" : "CPU"; }

std::unique_ptr<Backend> MakeCudaBackend(int /*gpu_index*/) {
  throw UserError("this program was built without CUDA. Give --use_gpu 0");
}

}  // namespace s2gs
