#include "sfm_split/scale/scale_bars.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "sfm_split/base/error.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

// Iglewicz and Hoaglin, "How to detect and handle outliers" (1993).
constexpr double kOutlierSigmas = 3.5;
// Paper and printers keep lengths to some thousandths: what differs less is no outlier, however well the
// others agree.
constexpr double kPrintTolerance = 0.003;

}  // namespace

ScaleEstimate EstimateScale(const std::vector<ScaleBar>& bars) {
  S2GS_INVARIANT(!bars.empty());
  std::vector<double> scales;
  scales.reserve(bars.size());
  for (const ScaleBar& bar : bars) {
    S2GS_INVARIANT(bar.known_m > 0 && bar.measured > 0);
    scales.push_back(bar.known_m / bar.measured);
  }
  const double middle = Summarize(scales).median;
  std::vector<double> distances;
  distances.reserve(scales.size());
  for (const double scale : scales) distances.push_back(std::abs(scale / middle - 1));
  const double spread = kSigmaOfMad * Summarize(distances).median;
  std::vector<double> known;
  for (const ScaleBar& bar : bars) {
    if (bar.sigma > 0) known.push_back(bar.sigma / bar.measured);
  }
  const double usual = known.empty() ? 0 : Summarize(known).median;
  ScaleEstimate estimate;
  double sum = 0;
  double weights = 0;
  for (size_t i = 0; i < bars.size(); ++i) {
    const double own = bars[i].sigma > 0 ? bars[i].sigma / bars[i].measured : usual;
    JudgedBar judged{bars[i], 0,
                     distances[i] > std::max(kPrintTolerance, kOutlierSigmas * std::max(spread, own))};
    // With two that differ nobody can say which is right.
    if (bars.size() < 3) judged.is_outlier = false;
    if (!judged.is_outlier) {
      const double weight = own > 0 ? 1 / (own * own + spread * spread + 1e-12) : 1;
      sum += weight * scales[i];
      weights += weight;
      ++estimate.num_used;
    }
    estimate.bars.push_back(judged);
  }
  estimate.metres_per_unit = sum / weights;
  double squares = 0;
  for (size_t i = 0; i < bars.size(); ++i) {
    JudgedBar& judged = estimate.bars[i];
    judged.residual_m = judged.bar.measured * estimate.metres_per_unit - judged.bar.known_m;
    if (!judged.is_outlier) squares += std::pow(scales[i] / estimate.metres_per_unit - 1, 2);
  }
  double common = 0;
  double one = std::numeric_limits<double>::quiet_NaN();
  for (const JudgedBar& judged : estimate.bars) {
    if (judged.is_outlier) continue;
    common = std::max(common, judged.bar.common_rel);
    if (judged.bar.sigma > 0) one = judged.bar.sigma / judged.bar.measured;
  }
  const int n = estimate.num_used;
  estimate.sigma_rel = std::hypot(n > 1 ? std::sqrt(squares / (n - 1.0) / n) : one, common);
  return estimate;
}

}  // namespace s2gs
