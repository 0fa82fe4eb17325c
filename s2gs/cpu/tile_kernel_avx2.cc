#define S2GS_TILE_NAMESPACE avx2
#include "s2gs/cpu/photo_kernel_impl.h"
#include "s2gs/cpu/tile_kernel_impl.h"

namespace s2gs {

const TileKernels& Avx2TileKernels() {
  static const TileKernels kernels = {"AVX2", avx2::Forward, avx2::Backward, avx2::PhotoLoss, avx2::Adam};
  return kernels;
}

}  // namespace s2gs
