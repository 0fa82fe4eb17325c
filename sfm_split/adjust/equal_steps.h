#pragma once

#include <vector>

#include "sfm_split/adjust/joint_ba.h"
#include "sfm_split/joint_system/joint_problem.h"

namespace s2gs {

/// Where an image stands in its station's order of capture.
struct CapturePlace {
  int station = 0;  ///< any number.
  int place = 0;
  int num_photos = 1;  ///< that the station has, with and without a pose.
};

/// The prior that a scan's own adjusted angles allow: that they lie about equal steps, and how closely. Steps
/// that make one whole turn over the station's photos to within half a step are that turn's. The width is the
/// largest that the angles' scatter about equal steps allows within two standard deviations, beside the
/// errors that the keypoints make (DataInflation; profile likelihood, one width for all stations): it never
/// is 0, and unequal steps make it so wide that it says nothing. Where the places are no order of capture
/// (names that say nothing), the order of the angles themselves is taken. Stations with too few images have
/// none. \param places  one per image of the problem. \param report  of an adjustment of the problem without
/// such priors, with covariances.
std::vector<EqualStepsPrior> FindEqualSteps(const JointProblem& problem,
                                            const std::vector<CapturePlace>& places,
                                            const JointReport& report);

/// Column of each image's table angle in the report's covariances; -1 where it is held.
std::vector<int> AngleColumns(const JointProblem& problem, const JointReport& report);

/// How much larger the angles' variances are than those of independent keypoint errors (median); at least 1.
double DataInflation(const JointProblem& problem, const JointReport& report);

}  // namespace s2gs
