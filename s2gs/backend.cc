#include "s2gs/backend.h"

namespace s2gs {

const char* BackendName(BackendKind kind) { return kind == BackendKind::kCuda ? "CUDA" : "CPU"; }

}  // namespace s2gs
