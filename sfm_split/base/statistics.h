#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

namespace s2gs {

/// Figures that sum up a set of errors. All are NaN when there are none.
struct Summary {
  int64_t count = 0;
  double mean = 0;
  double median = 0;  ///< the mean of the two in the middle when the count is even.
  double min = 0;
  double max = 0;
};

Summary Summarize(std::vector<double> values);

/// log of the probability that a Poisson variable of this mean (positive) reaches `count`.
double LogPoissonTail(int count, double mean);

/// A normal law's standard deviation over its median absolute one.
constexpr double kSigmaOfMad = 1.4826;

/// The median; the larger of the two in the middle when the count is even, so that it is always one of the
/// values; 0 when there are none.
template <typename T>
T UpperMedian(std::vector<T> values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// The value that `share` (0 to 1) of the values do not exceed: that at place share * (n - 1) of their order,
/// rounded down, so that it is always one of the values. There must be some.
template <typename T>
T Quantile(std::vector<T> values, double share) {
  const auto place =
      values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), place, values.end());
  return *place;
}

/// How much larger variances of a least-squares fit are than its residuals say, where the fit itself chooses
/// its data as what it misses by less than a bound: one that moves loses some and wins others, which draw it
/// on. Of N errors inside and n a unit of length at the bound b, N - b n tell where the fit is, and N seem
/// to: (N / (N - b n))^2. 1 where none are near the bound; normal errors cut off at their standard deviation
/// have 11.8. \param errors  of all data, chosen or not: absolute values, any order; NaN and infinite ones
/// are not chosen. \param bound  positive.
double VarianceOfChosen(const std::vector<double>& errors, double bound);

struct Line {
  double start = 0;  ///< y at x = 0.
  double slope = 0;
};

/// The line y = start + slope * x with the least sum of squared errors of y; nothing when all x are one.
std::optional<Line> FitLine(const std::vector<Eigen::Vector2d>& points);

}  // namespace s2gs
