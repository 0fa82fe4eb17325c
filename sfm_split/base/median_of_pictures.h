#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {

/// Of a camera that stands still: of fewer pictures what turns or passes by is in their median.
constexpr size_t kPicturesForMedian = 8;

/// What most of several pictures of one size show, value by value (UpperMedian).
/// \param pictures  values of each, as many as the first has; at least one. \param row  values in a row,
/// which one thread takes at a time. \param gains  what each picture's values are multiplied by before, up to
/// 255; empty: 1.
inline std::vector<uint8_t> MedianOfPictures(const std::vector<const std::vector<uint8_t>*>& pictures,
                                             size_t row, const std::vector<double>& gains = {}) {
  std::vector<uint8_t> median(pictures.front()->size());
  ParallelFor(static_cast<int64_t>(median.size() / row), 0, [&](int64_t y) {
    const size_t begin = row * static_cast<size_t>(y);
    std::vector<uint8_t> values(pictures.size());
    std::vector<double> brought(gains.size());
    for (size_t i = begin; i < begin + row; ++i) {
      if (gains.empty()) {
        for (size_t k = 0; k < pictures.size(); ++k) values[k] = (*pictures[k])[i];
        median[i] = UpperMedian(values);
      } else {
        for (size_t k = 0; k < pictures.size(); ++k) brought[k] = gains[k] * (*pictures[k])[i];
        median[i] = static_cast<uint8_t>(std::lround(std::min(255.0, UpperMedian(brought))));
      }
    }
  });
  return median;
}

}  // namespace s2gs
