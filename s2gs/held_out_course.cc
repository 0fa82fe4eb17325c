#include "s2gs/held_out_course.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace s2gs {
namespace {

// Student's t at 1 - kFalseStops / kMostLooks = .995 for 2, 3, ... degrees of freedom.
constexpr std::array<double, 9> kStudent = {9.925, 5.841, 4.604, 4.032, 3.707, 3.499, 3.355, 3.250, 3.169};
static_assert(HeldOutCourse::kFalseStops / HeldOutCourse::kMostLooks == 0.005);

}  // namespace

double HeldOutCourse::GainPct(double quantile) const {
  if (static_cast<int>(points_.size()) < kMinPoints) return std::numeric_limits<double>::infinity();
  // Least squares of the error's logarithm over progress.
  const auto count = static_cast<double>(points_.size());
  double mean_x = 0, mean_y = 0;
  for (const Point& point : points_) {
    mean_x += point.progress / count;
    mean_y += std::log(point.error) / count;
  }
  double xx = 0, xy = 0, yy = 0;
  for (const Point& point : points_) {
    const double x = point.progress - mean_x, y = std::log(point.error) - mean_y;
    xx += x * x;
    xy += x * y;
    yy += y * y;
  }
  if (!(xx > 0)) return std::numeric_limits<double>::infinity();
  const double slope = xy / xx;
  const double standard_error = std::sqrt(std::max(0.0, yy - slope * xy) / (count - 2) / xx);
  const double gain =
      100 * (1 - std::exp((slope - quantile * standard_error) * (1 - points_.back().progress)));
  return std::isfinite(gain) ? gain : std::numeric_limits<double>::infinity();
}

double HeldOutCourse::MostGainToComePct() const {
  if (static_cast<int>(points_.size()) < kMinPoints) return std::numeric_limits<double>::infinity();
  return GainPct(kStudent[std::min(points_.size() - kMinPoints, kStudent.size() - 1)]);
}

}  // namespace s2gs
