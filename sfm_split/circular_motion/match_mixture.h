#pragma once

#include <Eigen/Core>
#include <cmath>
#include <vector>

namespace s2gs {

// Matches of two photos are right or wrong, nobody knows which: their errors come from a mixture of both.

/// Width of a uniform distribution over its standard deviation, the square root of 12.
inline constexpr double kUniformWidth = 3.4641016151377546;

/// Of the density of a normal distribution.
inline constexpr double kRootTwoPi = 2.50662827463100050;

/// Least and largest standard deviation of a right match's epipolar error: keypoints are no better, and none
/// are found worse that are any use.
inline constexpr double kLeastSigmaPx = 0.3;
inline constexpr double kMostSigmaPx = 2;

/// Density of a right match's error over that of a wrong one's, where this is `over` without any error. Zero
/// without the exponential where what is left is less than the rounding of what it is added to, a wrong one's
/// share: with e^20 for `over`, of e^9 matches or fewer.
/// \param exponent  of the normal density: 0 or less.
inline double OverChance(double over, double exponent) {
  constexpr double kHopeless = -66;  // 20 + 9 + 37, the logarithm of a double's rounding
  return exponent > kHopeless ? over * std::exp(exponent) : 0;
}

/// The share of right ones among one pair's matches, in (0, 1), at which their errors are likeliest.
/// \param over  density of a right match's error over that of a wrong one's.
double RightShare(const std::vector<double>& over);

/// Logarithm of how much likelier than chance alone errors of one pair's matches are.
/// \param share  of right ones.
double MixtureGain(const std::vector<double>& over, double share);

/// That a match is right.
inline double RightProbability(double over, double share) {
  return share * over / (share * over + 1 - share);
}

/// Of all of a pair's matches.
std::vector<double> RightProbabilities(const std::vector<double>& over, double share);

/// How far keypoints spread, as the width of a uniform distribution of their deviation: a wrong match lies
/// anywhere along it.
class KeypointExtent {
 public:
  void Add(const Eigen::Vector2d& xy);
  /// [px]; 1 of no keypoints, and a uniform distribution's width at least.
  double Px() const;

 private:
  Eigen::Vector2d sum_ = Eigen::Vector2d::Zero();
  Eigen::Vector2d squares_ = Eigen::Vector2d::Zero();
  double num_ = 0;
};

}  // namespace s2gs
