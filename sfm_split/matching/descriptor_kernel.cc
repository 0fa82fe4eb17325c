#include "sfm_split/matching/descriptor_kernel.h"

#include <algorithm>

namespace s2gs {
namespace {

void Insert(int32_t key, int32_t* best, int32_t* second) {
  *second = std::max(*second, std::min(*best, key));
  *best = std::max(*best, key);
}

}  // namespace

PackedDescriptors::Weight DescriptorWeight(const uint8_t* packed) {
  int largest = 0;
  int largest_pair = 0;
  int energy[kDescriptorSize / 16] = {};
  for (int i = 0; i < kDescriptorSize; i += 2) {
    const int a = packed[i];
    const int b = packed[i + 1];
    largest = std::max(largest, std::max(a, b));
    largest_pair = std::max(largest_pair, a + b);
    energy[i / 32 * 2 + i / 2 % 2] += a * a + b * b;
  }
  if (largest_pair > 258 || *std::max_element(std::begin(energy), std::end(energy)) > 65535) {
    return PackedDescriptors::kHeavy;
  }
  return largest > 127 ? PackedDescriptors::kMedium : PackedDescriptors::kLight;
}

void MatchBlockPortable(const RowBlock& rows, const PackedDescriptors::Group* groups,
                        const int32_t* /*column_sums*/, int num_groups,
                        PackedDescriptors::Weight /*row_weight*/, PackedDescriptors::Weight /*column_weight*/,
                        BlockKeys* keys) {
  std::fill_n(keys->row_best, rows.num_rows, 0);
  std::fill_n(keys->row_second, rows.num_rows, 0);
  std::fill_n(keys->column_best, num_groups * PackedDescriptors::kGroupSize, 0);
  std::fill_n(keys->column_second, num_groups * PackedDescriptors::kGroupSize, 0);
  for (int row = 0; row < rows.num_rows; ++row) {
    for (int g = 0; g < num_groups; ++g) {
      int32_t dots[PackedDescriptors::kGroupSize] = {};
      for (int k = 0; k < kDescriptorSize / 4; ++k) {
        const uint8_t* a = rows.bytes[row] + 4 * k;
        for (int c = 0; c < PackedDescriptors::kGroupSize; ++c) {
          const uint8_t* b = groups[g].bytes[k][c];
          dots[c] += a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3];
        }
      }
      for (int c = 0; c < PackedDescriptors::kGroupSize; ++c) {
        const int column = g * PackedDescriptors::kGroupSize + c;
        const int32_t scaled = dots[c] << kKeyIndexBits;
        Insert(scaled + (kKeyIndexMask - column), &keys->row_best[row], &keys->row_second[row]);
        Insert(scaled + (kKeyIndexMask - row), &keys->column_best[column], &keys->column_second[column]);
      }
    }
  }
}

}  // namespace s2gs
