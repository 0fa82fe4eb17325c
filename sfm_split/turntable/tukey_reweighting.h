#pragma once

#include <vector>

namespace s2gs {

/// Rounds after which the weights of a reweighted fit have settled.
inline constexpr int kReweightings = 30;
inline constexpr double kRayleighMedian = 1.17741;  ///< median of |(x, y)|, x and y standard normal.
inline constexpr double kMaxwellMedian = 1.53817;   ///< the same in three dimensions.

/// Tukey's weights for residual lengths, cut at twice the inlier bound of the current spread. The spread is
/// the median of those within the bound of the last one, enlarged for few residuals (a fit goes through some
/// of them) as Rousseeuw does.
struct TukeyReweighting {
  double sigma;           ///< the spread, in the residuals' units; each call updates it.
  double median_of_unit;  ///< median residual length at sigma 1.
  double inlier_sigmas;   ///< the inlier bound.
  double floor;           ///< of sigma.
  int coordinates;        ///< of one residual.
  int parameters;         ///< of the fit.

  /// One weight in [0, 1] for each residual length.
  std::vector<double> operator()(const std::vector<double>& residuals);
};

}  // namespace s2gs
