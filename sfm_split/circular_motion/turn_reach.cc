#include "sfm_split/circular_motion/turn_reach.h"

#include <algorithm>
#include <cstddef>

namespace s2gs {
namespace {

constexpr double kOutlying = 0.02;  // of keypoints, left out on either side of what the object sweeps

double Extent(std::vector<float>* values) {
  std::sort(values->begin(), values->end());
  const auto out = static_cast<size_t>(kOutlying * static_cast<double>(values->size()));
  return values->empty() ? 0.0 : static_cast<double>((*values)[values->size() - 1 - out] - (*values)[out]);
}

}  // namespace

double SweptPx(std::vector<float> x, std::vector<float> y) { return std::max(Extent(&x), Extent(&y)); }

}  // namespace s2gs
