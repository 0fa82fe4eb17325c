#pragma once

#include <array>

#include "sfm_split/joint_system/joint_options.h"
#include "sfm_split/joint_system/joint_problem.h"

namespace s2gs {

/// How much the object's points count in the joint adjustment, by their number of keypoints: 2; 3 and 4; 5 to
/// 8; 9 to 16; and so on.
///
/// A feature that slides over the surface (an outline, a shade, a highlight) is lost after a step or two, so
/// that points of few keypoints are bent where those of many are not, and all to one side: their residuals
/// are small, and a hundred of them say what ten say. Errors of a class' n points with a correlation rho have
/// a mean whose variance is 1 + (n - 1) rho times that of independent ones (Kish's design effect), and each
/// point counts by one over that. Residuals do not show it; that classes contradict each other does.
struct TrackWeights {
  /// The last has all from 129 keypoints on: a judgement, few tracks are as long.
  static constexpr int kClasses = 8;
  double correlation = 0;  ///< rho, the same for all classes.
  std::array<double, kClasses> of_class = {1, 1, 1, 1, 1, 1, 1, 1};

  /// \param keypoints  2 or more.
  static int ClassOf(int keypoints);
};

/// By the median of what the correlation may be, by what each class by itself says of what all photos share
/// (cameras, axis) beside the background's and priors' say: the restricted likelihood of a random effect of
/// classes. Before that, none is as likely as any from where it matters on (one over the number of points),
/// and those are alike by their logarithms. By Newton's steps from a problem's optimum, errors as large as
/// points' residuals state them.
///
/// \param problem  at its optimum, its observations weighed as they are.
///
/// \param sigma_px  standard deviation of a keypoint's coordinate.
TrackWeights FitTrackWeights(const JointProblem& problem, const JointOptions& options, double sigma_px);

/// Sets the weights of the object's active observations.
void ApplyTrackWeights(const TrackWeights& weights, JointProblem* problem);

}  // namespace s2gs
