#include "s2gs/backend/backend.h"

namespace s2gs {

std::unique_ptr<Backend> MakeCudaBackend(int /*gpu_index*/) {
  throw UserError(
      "This s2gs was built without its CUDA backend. Install the CUDA Toolkit 12 or newer, configure with "
      "-DS2GS_CUDA=ON and build again, or compute on the CPU");
}

}  // namespace s2gs
