#pragma once

#include <string>
#include <vector>

namespace s2gs {

/// A length that is known, and the same as it was reconstructed.
struct ScaleBar {
  std::string name;
  double known_m = 0;   ///< [m], positive.
  double measured = 0;  ///< in the scene's unit, positive.
  double sigma = 0;     ///< standard deviation of `measured`; 0: unknown, as good as the other bars.
  /// Standard deviation, as a share, of an error that all bars of its kind have alike; no number of them
  /// averages it away.
  double common_rel = 0;
};

struct JudgedBar {
  ScaleBar bar;
  double residual_m = 0;    ///< measured length in metres less the known one.
  bool is_outlier = false;  ///< did not count.
};

struct ScaleEstimate {
  double metres_per_unit = 0;
  /// Standard deviation of the scale, as a share: from how much the bars differ and from what they have in
  /// common. NaN: one bar, of which nothing is known.
  double sigma_rel = 0;
  std::vector<JudgedBar> bars;
  int num_used = 0;
};

/// The scale from bars: the weighted mean of what each says, without those that are farther from the median
/// than noise and 3.5 robust standard deviations explain (misprinted, bent, or another marker's length).
/// \param bars  at least one.
ScaleEstimate EstimateScale(const std::vector<ScaleBar>& bars);

}  // namespace s2gs
