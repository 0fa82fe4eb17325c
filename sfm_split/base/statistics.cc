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
