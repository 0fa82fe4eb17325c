#pragma once

// Eight floats or whole numbers at a time, and what is done with them.
// Included by one source file per processor, which defines S2GS_TILE_NAMESPACE. Only built-in vectors and
// functions: an inline function of a library compiled here for AVX2 could be the copy that the linker keeps.

#include <cstdint>

#include "s2gs/cpu/tile_kernel.h"

// One file for each instruction set includes this in a namespace of its own.
// NOLINTBEGIN(misc-definitions-in-headers)

namespace s2gs {
namespace S2GS_TILE_NAMESPACE {
namespace {

#define S2GS_INLINE __attribute__((always_inline)) inline

typedef float Pack __attribute__((vector_size(32)));
typedef int32_t Ints __attribute__((vector_size(32)));
typedef int64_t Longs __attribute__((vector_size(32)));

S2GS_INLINE Pack Splat8(float x) { return Pack{x, x, x, x, x, x, x, x}; }
S2GS_INLINE Ints Splat8(int32_t x) { return Ints{x, x, x, x, x, x, x, x}; }
S2GS_INLINE Pack Load(const float* p) {
  Pack v;
  __builtin_memcpy(&v, p, sizeof(v));
  return v;
}
S2GS_INLINE void Store(float* p, Pack v) { __builtin_memcpy(p, &v, sizeof(v)); }
S2GS_INLINE Ints LoadInts(const int32_t* p) {
  Ints v;
  __builtin_memcpy(&v, p, sizeof(v));
  return v;
}
S2GS_INLINE void StoreInts(int32_t* p, Ints v) { __builtin_memcpy(p, &v, sizeof(v)); }
// Lanes of the mask keep their value, the others become 0.
S2GS_INLINE Pack Where(Ints mask, Pack v) { return (Pack)(mask & (Ints)v); }
S2GS_INLINE Pack Select(Ints mask, Pack a, Pack b) { return (Pack)((mask & (Ints)a) | (~mask & (Ints)b)); }
S2GS_INLINE bool Any(Ints mask) {
  const Longs v = (Longs)mask;
  return ((v[0] | v[1]) | (v[2] | v[3])) != 0;
}
S2GS_INLINE Pack Min(Pack a, Pack b) { return Select(a < b, a, b); }
S2GS_INLINE Pack Max(Pack a, Pack b) { return Select(a > b, a, b); }
S2GS_INLINE float Sum(Pack v) { return ((v[0] + v[4]) + (v[2] + v[6])) + ((v[1] + v[5]) + (v[3] + v[7])); }
S2GS_INLINE float Largest(Pack v) {
  float largest = v[0];
  for (int i = 1; i < kPackWidth; ++i) largest = v[i] > largest ? v[i] : largest;
  return largest;
}

// e^x for x in [-80, 0] to 2 units in the last place: 2^n 2^f, f in [-1/2, 1/2] by its Taylor series.
S2GS_INLINE Pack ExpOfNegative(Pack x) {
  const Pack magic = Splat8(12582912.0F);  // 1.5 * 2^23: adding it rounds to whole numbers
  const Pack t = Max(x, Splat8(-80.0F)) * 1.44269504F;
  const Pack shifted = t + magic;
  const Pack n = shifted - magic;
  const Pack f = t - n;
  Pack p = Splat8(1.5403530e-4F);
  p = p * f + 1.3333558e-3F;
  p = p * f + 9.6181291e-3F;
  p = p * f + 5.5504109e-2F;
  p = p * f + 2.4022651e-1F;
  p = p * f + 6.9314718e-1F;
  p = p * f + 1.0F;
  const Ints power = ((Ints)shifted << 23) + Splat8(0x3F800000);
  return p * (Pack)power;
}

}  // namespace
}  // namespace S2GS_TILE_NAMESPACE
}  // namespace s2gs
// NOLINTEND(misc-definitions-in-headers)
