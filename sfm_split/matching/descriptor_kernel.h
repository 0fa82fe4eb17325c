#pragma once

#include <cstdint>

#include "sfm_split/matching/descriptor_match.h"

namespace s2gs {

// A block of the table of all dot products: up to kRowsPerBlock descriptors of one image (rows) against up to
// kGroupsPerBlock groups of the other (columns). Within a block a candidate is one integer, its key:
//   key = dot * 256 + (255 - index within the block),
// so that one maximum finds the largest dot product and, among equals, the lowest index. The largest dot
// product of bytes, 128 * 255^2, leaves the key below 2^31.
inline constexpr int kKeyIndexBits = 8;
inline constexpr int kKeyIndexMask = (1 << kKeyIndexBits) - 1;
inline constexpr int kRowsPerBlock = 240;     // a multiple of every kernel's tile height
inline constexpr int kColumnsPerBlock = 256;  // as many as the bits of a key's index tell apart
inline constexpr int kGroupsPerBlock = kColumnsPerBlock / PackedDescriptors::kGroupSize;  // 16

static_assert(kRowsPerBlock <= 1 << kKeyIndexBits && kColumnsPerBlock <= 1 << kKeyIndexBits);
static_assert((int64_t{kDescriptorSize} * 255 * 255 << kKeyIndexBits) + kKeyIndexMask <= INT32_MAX);

/// Descriptors of one block's rows, bytes permuted as in the groups; rows beyond the last one are zero.
struct RowBlock {
  alignas(64) uint8_t bytes[kRowsPerBlock][kDescriptorSize];
  int num_rows = 0;
};

/// Largest and second largest key of every row and every column of a block. Zero where there is none.
struct BlockKeys {
  alignas(64) int32_t row_best[kRowsPerBlock];
  alignas(64) int32_t row_second[kRowsPerBlock];
  alignas(64) int32_t column_best[kColumnsPerBlock];
  alignas(64) int32_t column_second[kColumnsPerBlock];
};

/// \param column_sums    per column: the sum of its descriptor's bytes.
/// \param row_weight     the weight of all rows,
/// \param column_weight  and of all columns.
using BlockKernel = void (*)(const RowBlock& rows, const PackedDescriptors::Group* groups,
                             const int32_t* column_sums, int num_groups, PackedDescriptors::Weight row_weight,
                             PackedDescriptors::Weight column_weight, BlockKeys* keys);

/// Where byte i of a packed descriptor comes from. Bytes are read in four chunks of 32; 16-bit lane j (0 or
/// 1) of a chunk sums the products of its bytes 4k + 2j and 4k + 2j + 1. The permutation gives each of these
/// eight lanes one byte of every one of SIFT's 4x4 cells, and an orientation that differs between
/// neighbouring cells, so that the energy spreads over the lanes.
inline int DescriptorPermutation(int i) {
  const int lane = i / 32 * 2 + i / 2 % 2;
  const int cell = i % 32 / 4 * 2 + i % 2;
  const int orientation = (lane + 16 * 8 - 3 * cell - cell / 4) % 8;
  return cell * 8 + orientation;
}

/// The weight of a descriptor. Products of a light one with a light or medium one, as an unsigned times a
/// signed byte, sum exactly in each 16-bit lane:
/// - light: no byte exceeds 127, so it can be the signed factor; squares sum to at most 65535 in each lane;
/// - medium: two bytes that are multiplied and added at once sum to at most 258, and 127 * 258 fits a signed
///   16-bit integer; squares as above, so by Cauchy-Schwarz the lane's sum fits an unsigned 16-bit integer;
/// - heavy: the others, which need wider products.
/// \param packed  128 bytes in packed order.
PackedDescriptors::Weight DescriptorWeight(const uint8_t* packed);

void MatchBlockPortable(const RowBlock& rows, const PackedDescriptors::Group* groups,
                        const int32_t* column_sums, int num_groups, PackedDescriptors::Weight row_weight,
                        PackedDescriptors::Weight column_weight, BlockKeys* keys);

#if defined(__x86_64__)
void MatchBlockAvx2(const RowBlock& rows, const PackedDescriptors::Group* groups, const int32_t* column_sums,
                    int num_groups, PackedDescriptors::Weight row_weight,
                    PackedDescriptors::Weight column_weight, BlockKeys* keys);
void MatchBlockAvx512Vnni(const RowBlock& rows, const PackedDescriptors::Group* groups,
                          const int32_t* column_sums, int num_groups, PackedDescriptors::Weight row_weight,
                          PackedDescriptors::Weight column_weight, BlockKeys* keys);
#endif

}  // namespace s2gs
