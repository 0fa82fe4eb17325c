#define S2GS_TILE_NAMESPACE portable
// Vectors of eight are passed between functions that are all inlined: how they would be passed does not
// matter.
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC diagnostic ignored "-Wpsabi"
#endif
#include "s2gs/cpu/photo_kernel_impl.h"
#include "s2gs/cpu/tile_kernel_impl.h"

namespace s2gs {

const TileKernels& PortableTileKernels() {
  static const TileKernels kernels = {"portable", portable::Forward, portable::Backward, portable::PhotoLoss,
                                      portable::Adam};
  return kernels;
}

const TileKernels& BestTileKernels() {
#if defined(__x86_64__)
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) return Avx2TileKernels();
#endif
  return PortableTileKernels();
}

}  // namespace s2gs
