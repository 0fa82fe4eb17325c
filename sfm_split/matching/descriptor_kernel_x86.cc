#include "sfm_split/matching/descriptor_kernel.h"

#if defined(__x86_64__)

#include <immintrin.h>

#if defined(__GNUC__) && !defined(__clang__)
// False positives inside the compiler's own AVX-512 header.
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"
#pragma GCC diagnostic ignored "-Wuninitialized"
#endif

#include <algorithm>
#include <cstring>

// Target attributes instead of compiler flags for this file: inline functions of the standard library that
// are instantiated here stay free of instructions that other processors lack.
#define S2GS_AVX2 __attribute__((target("avx2")))
#define S2GS_AVX512 __attribute__((target("avx512f,avx512bw,avx512vl,avx512vnni")))
#define S2GS_INLINE __attribute__((always_inline)) inline

namespace s2gs {
namespace {

constexpr int kSteps = kDescriptorSize / 4;  // four bytes a step
constexpr int kRowBytes = kDescriptorSize;   // one byte a value

// --- AVX2: tiles of 6 rows x 16 columns, two registers of 8 columns a row ----------------------------------

constexpr int kRows2 = 6;  // 12 of 16 registers hold sums
static_assert(kRowsPerBlock % kRows2 == 0);

struct Tile2 {
  __m256i scaled[kRows2][2];  // 256 * dot
};

S2GS_AVX2 S2GS_INLINE __m256i Broadcast4(const uint8_t* bytes) {
  int32_t word = 0;
  std::memcpy(&word, bytes, sizeof(word));
  return _mm256_set1_epi32(word);
}

// Keeps the compiler from moving sums past each other: a tile fills the sixteen registers exactly, and any
// other order of its sums spills them to memory at every step.
S2GS_AVX2 S2GS_INLINE void Pin(__m256i* sum) { asm volatile("" : "+x"(*sum)); }

// The factor of medium weight, if any, must be the unsigned one, which is the instruction's first operand.
template <bool kFirst, bool kRowsSigned>
S2GS_AVX2 S2GS_INLINE void StepNarrow(const uint8_t* rows, const uint8_t* group, __m256i (*sum)[2]) {
  const __m256i b0 = _mm256_load_si256(reinterpret_cast<const __m256i*>(group));
  const __m256i b1 = _mm256_load_si256(reinterpret_cast<const __m256i*>(group + 32));
#pragma GCC unroll 6
  for (int r = 0; r < kRows2; ++r) {
    const __m256i a = Broadcast4(rows + r * kRowBytes);
    const __m256i p0 = kRowsSigned ? _mm256_maddubs_epi16(b0, a) : _mm256_maddubs_epi16(a, b0);
    const __m256i p1 = kRowsSigned ? _mm256_maddubs_epi16(b1, a) : _mm256_maddubs_epi16(a, b1);
    sum[r][0] = kFirst ? p0 : _mm256_add_epi16(sum[r][0], p0);
    sum[r][1] = kFirst ? p1 : _mm256_add_epi16(sum[r][1], p1);
    Pin(&sum[r][0]);
    Pin(&sum[r][1]);
  }
}

// Products summed in 16 bits, eight steps at a time, then widened. The 16-bit sums are
// unsigned; taking 2^15 off makes them signed for the widening multiply-add, which also scales by 256.
template <bool kRowsSigned>
S2GS_AVX2 S2GS_INLINE void DotsNarrow(const uint8_t* rows, const uint8_t* group, Tile2* tile) {
  constexpr int kStepsPerChunk = 8;                 // so many steps' sums fit 16 bits
  constexpr int kChunks = kSteps / kStepsPerChunk;  // 4
  const __m256i sign = _mm256_set1_epi16(INT16_MIN);
  const __m256i scale = _mm256_set1_epi16(1 << kKeyIndexBits);
  const __m256i bias = _mm256_set1_epi32(kChunks * 2 * (1 << 15) << kKeyIndexBits);
  for (int chunk = 0; chunk < kChunks; ++chunk) {
    __m256i sum[kRows2][2];
    const uint8_t* chunk_rows = rows + chunk * kStepsPerChunk * 4;
    const uint8_t* chunk_group = group + chunk * kStepsPerChunk * 64;
    StepNarrow<true, kRowsSigned>(chunk_rows, chunk_group, sum);
#pragma GCC unroll 7
    for (int k = 1; k < kStepsPerChunk; ++k)
      StepNarrow<false, kRowsSigned>(chunk_rows + k * 4, chunk_group + k * 64, sum);
#pragma GCC unroll 6
    for (int r = 0; r < kRows2; ++r) {
#pragma GCC unroll 2
      for (int h = 0; h < 2; ++h) {
        const __m256i wide = _mm256_madd_epi16(_mm256_xor_si256(sum[r][h], sign), scale);
        tile->scaled[r][h] = _mm256_add_epi32(chunk == 0 ? bias : tile->scaled[r][h], wide);
      }
    }
  }
}

// Any descriptors: bytes widened to 16 bits, even and odd ones apart.
S2GS_AVX2 S2GS_INLINE void DotsWide(const uint8_t* rows, const uint8_t* group, Tile2* tile) {
  const __m256i low_byte = _mm256_set1_epi16(0xFF);
  for (int h = 0; h < 2; ++h) {
    __m256i sum[kRows2];
#pragma GCC unroll 6
    for (int r = 0; r < kRows2; ++r) sum[r] = _mm256_setzero_si256();
    for (int step = 0; step < kSteps; ++step) {
      const __m256i b = _mm256_load_si256(reinterpret_cast<const __m256i*>(group + step * 64 + h * 32));
      const __m256i b_even = _mm256_and_si256(b, low_byte);
      const __m256i b_odd = _mm256_srli_epi16(b, 8);
#pragma GCC unroll 6
      for (int r = 0; r < kRows2; ++r) {
        const __m256i a = Broadcast4(rows + r * kRowBytes + step * 4);
        const __m256i even = _mm256_madd_epi16(_mm256_and_si256(a, low_byte), b_even);
        const __m256i odd = _mm256_madd_epi16(_mm256_srli_epi16(a, 8), b_odd);
        sum[r] = _mm256_add_epi32(sum[r], _mm256_add_epi32(even, odd));
      }
    }
#pragma GCC unroll 6
    for (int r = 0; r < kRows2; ++r) tile->scaled[r][h] = _mm256_slli_epi32(sum[r], kKeyIndexBits);
  }
}

S2GS_AVX2 S2GS_INLINE void Insert(__m256i key, __m256i* best, __m256i* second) {
  *second = _mm256_max_epi32(*second, _mm256_min_epi32(*best, key));
  *best = _mm256_max_epi32(*best, key);
}

// Best and second best of the eight lanes' bests and second bests.
S2GS_AVX2 S2GS_INLINE void Reduce(__m256i best, __m256i second, int32_t* out_best, int32_t* out_second) {
  const auto merge = [&](__m256i other_best, __m256i other_second) S2GS_AVX2 {
    second = _mm256_max_epi32(_mm256_max_epi32(second, other_second), _mm256_min_epi32(best, other_best));
    best = _mm256_max_epi32(best, other_best);
  };
  merge(_mm256_permute2x128_si256(best, best, 1), _mm256_permute2x128_si256(second, second, 1));
  merge(_mm256_shuffle_epi32(best, 0x4E), _mm256_shuffle_epi32(second, 0x4E));
  merge(_mm256_shuffle_epi32(best, 0xB1), _mm256_shuffle_epi32(second, 0xB1));
  *out_best = _mm256_cvtsi256_si32(best);
  *out_second = _mm256_cvtsi256_si32(second);
}

enum class Products { kNarrow, kNarrowRowsSigned, kWide };

template <Products kProducts>
S2GS_AVX2 void MatchBlock2(const RowBlock& rows, const PackedDescriptors::Group* groups, int num_groups,
                           BlockKeys* keys) {
  const __m256i lane = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
  for (int row = 0; row < rows.num_rows; row += kRows2) {
    __m256i row_best[kRows2];
    __m256i row_second[kRows2];
    for (int r = 0; r < kRows2; ++r) row_best[r] = row_second[r] = _mm256_setzero_si256();
    for (int g = 0; g < num_groups; ++g) {
      Tile2 tile;
      if constexpr (kProducts == Products::kNarrow) {
        DotsNarrow<false>(rows.bytes[row], &groups[g].bytes[0][0][0], &tile);
      } else if constexpr (kProducts == Products::kNarrowRowsSigned) {
        DotsNarrow<true>(rows.bytes[row], &groups[g].bytes[0][0][0], &tile);
      } else {
        DotsWide(rows.bytes[row], &groups[g].bytes[0][0][0], &tile);
      }
#pragma GCC unroll 2
      for (int h = 0; h < 2; ++h) {
        const int column = g * PackedDescriptors::kGroupSize + h * 8;
        const __m256i column_index = _mm256_sub_epi32(_mm256_set1_epi32(kKeyIndexMask - column), lane);
        auto* best_out = reinterpret_cast<__m256i*>(keys->column_best + column);
        auto* second_out = reinterpret_cast<__m256i*>(keys->column_second + column);
        __m256i best = _mm256_load_si256(best_out);
        __m256i second = _mm256_load_si256(second_out);
#pragma GCC unroll 6
        for (int r = 0; r < kRows2; ++r) {
          const __m256i scaled = tile.scaled[r][h];
          Insert(_mm256_add_epi32(scaled, _mm256_set1_epi32(kKeyIndexMask - row - r)), &best, &second);
          Insert(_mm256_add_epi32(scaled, column_index), &row_best[r], &row_second[r]);
        }
        _mm256_store_si256(best_out, best);
        _mm256_store_si256(second_out, second);
      }
    }
    for (int r = 0; r < kRows2; ++r) {
      Reduce(row_best[r], row_second[r], &keys->row_best[row + r], &keys->row_second[row + r]);
    }
  }
}

// --- AVX-512 VNNI: tiles of 8 rows x 32 columns, one register of 16 columns a row and group
// ------------------

constexpr int kRows5 = 8;  // 16 of 32 registers hold sums
static_assert(kRowsPerBlock % kRows5 == 0);

S2GS_AVX512 S2GS_INLINE void Insert(__m512i key, __m512i* best, __m512i* second) {
  *second = _mm512_max_epi32(*second, _mm512_min_epi32(*best, key));
  *best = _mm512_max_epi32(*best, key);
}

S2GS_AVX512 S2GS_INLINE void Reduce(__m512i best, __m512i second, int32_t* out_best, int32_t* out_second) {
  const auto merge = [&](__m512i other_best, __m512i other_second) S2GS_AVX512 {
    second = _mm512_max_epi32(_mm512_max_epi32(second, other_second), _mm512_min_epi32(best, other_best));
    best = _mm512_max_epi32(best, other_best);
  };
  merge(_mm512_shuffle_i32x4(best, best, 0x4E), _mm512_shuffle_i32x4(second, second, 0x4E));
  merge(_mm512_shuffle_i32x4(best, best, 0xB1), _mm512_shuffle_i32x4(second, second, 0xB1));
  merge(_mm512_shuffle_epi32(best, _MM_PERM_BADC), _mm512_shuffle_epi32(second, _MM_PERM_BADC));
  merge(_mm512_shuffle_epi32(best, _MM_PERM_CDAB), _mm512_shuffle_epi32(second, _MM_PERM_CDAB));
  *out_best = _mm512_cvtsi512_si32(best);
  *out_second = _mm512_cvtsi512_si32(second);
}

// The instruction multiplies unsigned by signed bytes: the rows' bytes have 128 taken off, and 128 times the
// column's sum is added back.
template <int kGroups>
S2GS_AVX512 S2GS_INLINE void MatchTile5(const uint8_t* signed_rows, int row,
                                        const PackedDescriptors::Group* groups, const int32_t* column_sums,
                                        int first_group, __m512i* row_best, __m512i* row_second,
                                        BlockKeys* keys) {
  const __m512i lane = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
  __m512i sum[kRows5][kGroups];
#pragma GCC unroll 2
  for (int g = 0; g < kGroups; ++g) {
    const __m512i column_sum =
        _mm512_loadu_si512(column_sums + (first_group + g) * PackedDescriptors::kGroupSize);
#pragma GCC unroll 8
    for (int r = 0; r < kRows5; ++r) sum[r][g] = _mm512_slli_epi32(column_sum, 7);
  }
#pragma GCC unroll 4
  for (int step = 0; step < kSteps; ++step) {
    __m512i b[kGroups];
#pragma GCC unroll 2
    for (int g = 0; g < kGroups; ++g) b[g] = _mm512_load_si512(&groups[first_group + g].bytes[step]);
#pragma GCC unroll 8
    for (int r = 0; r < kRows5; ++r) {
      int32_t word = 0;
      std::memcpy(&word, signed_rows + r * kRowBytes + step * 4, sizeof(word));
      const __m512i a = _mm512_set1_epi32(word);
#pragma GCC unroll 2
      for (int g = 0; g < kGroups; ++g) sum[r][g] = _mm512_dpbusd_epi32(sum[r][g], b[g], a);
    }
  }
#pragma GCC unroll 2
  for (int g = 0; g < kGroups; ++g) {
    const int column = (first_group + g) * PackedDescriptors::kGroupSize;
    const __m512i column_index = _mm512_sub_epi32(_mm512_set1_epi32(kKeyIndexMask - column), lane);
    __m512i best = _mm512_load_si512(keys->column_best + column);
    __m512i second = _mm512_load_si512(keys->column_second + column);
#pragma GCC unroll 8
    for (int r = 0; r < kRows5; ++r) {
      const __m512i scaled = _mm512_slli_epi32(sum[r][g], kKeyIndexBits);
      Insert(_mm512_add_epi32(scaled, _mm512_set1_epi32(kKeyIndexMask - row - r)), &best, &second);
      Insert(_mm512_add_epi32(scaled, column_index), &row_best[r], &row_second[r]);
    }
    _mm512_store_si512(keys->column_best + column, best);
    _mm512_store_si512(keys->column_second + column, second);
  }
}

}  // namespace

S2GS_AVX2 void MatchBlockAvx2(const RowBlock& rows, const PackedDescriptors::Group* groups,
                              const int32_t* /*column_sums*/, int num_groups,
                              PackedDescriptors::Weight row_weight, PackedDescriptors::Weight column_weight,
                              BlockKeys* keys) {
  std::fill_n(keys->column_best, num_groups * PackedDescriptors::kGroupSize, 0);
  std::fill_n(keys->column_second, num_groups * PackedDescriptors::kGroupSize, 0);
  if (row_weight != PackedDescriptors::kHeavy && column_weight == PackedDescriptors::kLight) {
    MatchBlock2<Products::kNarrow>(rows, groups, num_groups, keys);
  } else if (row_weight == PackedDescriptors::kLight && column_weight == PackedDescriptors::kMedium) {
    MatchBlock2<Products::kNarrowRowsSigned>(rows, groups, num_groups, keys);
  } else {
    MatchBlock2<Products::kWide>(rows, groups, num_groups, keys);
  }
}

S2GS_AVX512 void MatchBlockAvx512Vnni(const RowBlock& rows, const PackedDescriptors::Group* groups,
                                      const int32_t* column_sums, int num_groups,
                                      PackedDescriptors::Weight /*row_weight*/,
                                      PackedDescriptors::Weight /*column_weight*/, BlockKeys* keys) {
  std::fill_n(keys->column_best, num_groups * PackedDescriptors::kGroupSize, 0);
  std::fill_n(keys->column_second, num_groups * PackedDescriptors::kGroupSize, 0);
  alignas(64) uint8_t signed_rows[kRows5 * kRowBytes];
  const __m512i offset = _mm512_set1_epi32(static_cast<int32_t>(0x80808080U));
  for (int row = 0; row < rows.num_rows; row += kRows5) {
    for (int i = 0; i < kRows5 * kRowBytes; i += 64) {
      _mm512_store_si512(signed_rows + i, _mm512_xor_si512(_mm512_load_si512(rows.bytes[row] + i), offset));
    }
    __m512i row_best[kRows5];
    __m512i row_second[kRows5];
    for (int r = 0; r < kRows5; ++r) row_best[r] = row_second[r] = _mm512_setzero_si512();
    int g = 0;
    for (; g + 2 <= num_groups; g += 2) {
      MatchTile5<2>(signed_rows, row, groups, column_sums, g, row_best, row_second, keys);
    }
    if (g < num_groups) MatchTile5<1>(signed_rows, row, groups, column_sums, g, row_best, row_second, keys);
    for (int r = 0; r < kRows5; ++r) {
      Reduce(row_best[r], row_second[r], &keys->row_best[row + r], &keys->row_second[row + r]);
    }
  }
}

}  // namespace s2gs

#endif  // __x86_64__
