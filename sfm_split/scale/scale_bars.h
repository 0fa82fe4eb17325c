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
};

struct JudgedBar {
  ScaleBar bar;
  double residual_m = 0;    ///< measured length in metres less the known one.
  bool is_outlier = false;  ///< did not count.
};

struct ScaleEstimate {
  double metres_per_unit = 0;
  double sigma_rel =
      0;  ///< standard deviation of the scale, as a share; from how much the bars differ. NaN: one bar.
  std::vector<JudgedBar> bars;
  int num_used = 0;
};

/// The scale from bars: the weighted mean of what each says, without those that are farther from the median
/// than noise and 3.5 robust standard deviations explain (misprinted, bent, or another marker's length).
/// \param bars  at least one.
ScaleEstimate EstimateScale(const std::vector<ScaleBar>& bars);

}  // namespace s2gs
