#pragma once

#include <Eigen/Core>

#include "sfm_split/joint_system/reduced_system.h"

namespace s2gs {

/// The covariance of the gradient, from the observations' own shares of it.
struct ScoreCovariance {
  Eigen::MatrixXd of_points;   ///< errors of the keypoints of one point may depend on each other.
  Eigen::MatrixXd of_regions;  ///< and so may those in one part of the photos.
  Eigen::MatrixXd of_rings;    ///< or in one ring about the axis.
};

/// Liang and Zeger's estimate with points as clusters, with the gradients that these would have without their
/// own pull on the parameters (the jackknife, Bell and McCaffrey's CR3): with few points to many parameters,
/// residuals are much smaller than errors. Shading and foreshortening move features alike in one part of the
/// photos: parts as clusters are added, less, as Cameron, Gelbach and Miller join two ways of clustering,
/// what both count.
ScoreCovariance CovarianceOfScores(const ReducedSystem& reduced, const Eigen::MatrixXd& inverse_system,
                                   int num_threads);

}  // namespace s2gs
