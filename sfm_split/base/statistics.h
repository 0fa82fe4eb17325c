#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
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

/// The median; the larger of the two in the middle when the count is even, so that it is always one of the
/// values; 0 when there are none.
template <typename T>
T UpperMedian(std::vector<T> values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace s2gs
