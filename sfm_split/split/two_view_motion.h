#pragma once

#include <Eigen/Core>
#include <vector>

#include "sfm_split/base/error.h"
#include "sfm_split/split/stations.h"

namespace s2gs {

struct TwoViewMotionOptions {
  double max_error_px = 1.5;   ///< noise scale of the MAGSAC fit: largest Sampson error of an inlier [px].
  double confidence = 0.9999;  ///< of the robust fit.
  int max_iterations = 10000;  ///< of the robust fit.
  int min_inliers = 15;        ///< a motion with fewer is no motion (COLMAP's bound).
  int max_motions = 3;         ///< bodies looked for in one pair by FitMotions.

  OptionCheck Check() const;
};

/// One rigid motion between two images: x2ᵀ F x1 = 0 for pixel positions, and a homography when all its
/// points lie on one plane (or the camera only turned).
struct TwoViewMotion {
  Eigen::Matrix3d F = Eigen::Matrix3d::Zero();
  Eigen::Matrix3d H = Eigen::Matrix3d::Zero();  ///< zero unless is_planar.
  bool is_planar = false;
  std::vector<int> inliers;  ///< positions in the list of matches given, ascending.
};

/// Sampson's error, unsigned, of the fundamental matrix F at a pair of pixel positions [px].
double SampsonErrorPx(const Eigen::Matrix3d& F, const Eigen::Vector2f& xy1, const Eigen::Vector2f& xy2);

/// The motion that most of `subset` (positions in `matches`) follows; no inliers when there is none with at
/// least min_inliers. Deterministic.
TwoViewMotion FitMotion(const Keypoints& keypoints1, const Keypoints& keypoints2,
                        const FeatureMatches& matches, const std::vector<int>& subset,
                        const TwoViewMotionOptions& options);

/// Several motions, the strongest first, each fitted to what the ones before left over.
std::vector<TwoViewMotion> FitMotions(const Keypoints& keypoints1, const Keypoints& keypoints2,
                                      const FeatureMatches& matches, const std::vector<int>& subset,
                                      const TwoViewMotionOptions& options);

}  // namespace s2gs
