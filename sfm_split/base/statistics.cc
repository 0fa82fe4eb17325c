#include "sfm_split/base/statistics.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

namespace s2gs {

Summary Summarize(std::vector<double> values) {
  Summary summary;
  summary.count = static_cast<int64_t>(values.size());
  if (values.empty()) {
    summary.mean = summary.median = summary.min = summary.max = std::numeric_limits<double>::quiet_NaN();
    return summary;
  }
  std::sort(values.begin(), values.end());
  const size_t middle = values.size() / 2;
  // In sorted order: the same sum whatever order the errors came in.
  summary.mean = std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
  summary.median = values.size() % 2 == 1 ? values[middle] : (values[middle - 1] + values[middle]) / 2;
  summary.min = values.front();
  summary.max = values.back();
  return summary;
}

double VarianceOfChosen(const std::vector<double>& errors, double bound) {
  constexpr double kShell = 1.25;  // a judgement: a bound times and over this holds what lies at it
  double inside = 0;
  double at_bound = 0;
  for (const double error : errors) {
    if (error <= bound) inside += 1;
    if (error > bound / kShell && error <= bound * kShell) at_bound += 1;
  }
  if (!(inside > 0)) return 1;
  const double width = 2 * std::log(kShell);
  // What is not told from nothing is no less than its own standard deviation.
  const double telling = std::max(inside - at_bound / width, std::sqrt(at_bound + 1) / width);
  const double ratio = std::max(1.0, inside / telling);
  return ratio * ratio;
}

std::optional<Line> FitLine(const std::vector<Eigen::Vector2d>& points) {
  const auto n = static_cast<double>(points.size());
  double sum_x = 0;
  double sum_xx = 0;
  double sum_y = 0;
  double sum_xy = 0;
  for (const Eigen::Vector2d& point : points) {
    sum_x += point.x();
    sum_xx += point.x() * point.x();
    sum_y += point.y();
    sum_xy += point.x() * point.y();
  }
  const double determinant = n * sum_xx - sum_x * sum_x;
  if (!(determinant > 0)) return std::nullopt;
  Line line;
  line.slope = (n * sum_xy - sum_x * sum_y) / determinant;
  line.start = (sum_y - line.slope * sum_x) / n;
  return line;
}

double LogPoissonTail(int count, double mean) {
  if (count <= 0) return 0;
  // Terms after the first, over it.
  double sum = 0;
  double term = 1;
  for (int k = count; k < count + 200 && term > 1e-12; ++k) {
    sum += term;
    term *= mean / (k + 1);
  }
  return std::min(0.0, count * std::log(mean) - mean - std::lgamma(count + 1.0) + std::log(sum));
}

}  // namespace s2gs
