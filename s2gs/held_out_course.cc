#include "s2gs/held_out_course.h"

#include <cmath>
#include <limits>

namespace s2gs {

double HeldOutCourse::GainToComePct() const {
  if (static_cast<int>(points_.size()) < kNumForSlope) return std::numeric_limits<double>::infinity();
  // Least squares of the error's logarithm over progress.
  const size_t first = points_.size() - kNumForSlope;
  double mean_x = 0, mean_y = 0;
  for (size_t i = first; i < points_.size(); ++i) {
    mean_x += points_[i].progress / kNumForSlope;
    mean_y += std::log(points_[i].error) / kNumForSlope;
  }
  double xx = 0, xy = 0;
  for (size_t i = first; i < points_.size(); ++i) {
    const double x = points_[i].progress - mean_x;
    xx += x * x;
    xy += x * (std::log(points_[i].error) - mean_y);
  }
  const double slope = xx > 0 ? xy / xx : 0;
  const double gain = 100 * (1 - std::exp(slope * (1 - points_.back().progress)));
  return std::isfinite(gain) ? gain : std::numeric_limits<double>::infinity();
}

}  // namespace s2gs
