#pragma once

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

}  // namespace s2gs
