#pragma once

#include <optional>
#include <string>
#include <vector>

#include "sfm_split/adjust/equal_steps.h"
#include "sfm_split/adjust/joint_ba.h"
#include "sfm_split/joint_system/joint_problem.h"

namespace s2gs {

/// What table angles that somebody states are worth, by the scan's own adjusted angles. A station's angles
/// are stated but for a constant and for the sense of the turn.
struct KnownAngles {
  int station = 0;
  bool is_believed = false;      ///< the prior below is one to adjust by.
  EqualStepsPrior prior;         ///< places are stated angles [rad], the step is +1 or -1.
  double spacing_rad = 0;        ///< median between stated angles that follow each other around.
  double scatter_rad = 0;        ///< root mean square of adjusted against stated angles, without those below.
  double factor = 1;             ///< what stated angles have to be multiplied by to fit best.
  double factor_sigma = 0;       ///< its standard deviation, by the scatter and the keypoints.
  std::vector<int> contradicts;  ///< images whose adjusted angle is another by more than half a spacing.
};

/// Compares each station's adjusted angles with stated ones. They are believed where more than half of the
/// images, and at least three, lie within half a spacing; only these are in the prior. Its width is the
/// largest that their scatter allows within two standard deviations, beside the errors that the keypoints
/// make, one for all stations (as FindEqualSteps): angles that are not those of the photos make it so wide
/// that it says nothing. \param stations  one per image of the problem. \param stated_rad  the same; nothing
/// where none is stated. \param report  of an adjustment without such priors, with covariances.
std::vector<KnownAngles> CompareKnownAngles(const JointProblem& problem, const std::vector<int>& stations,
                                            const std::vector<std::optional<double>>& stated_rad,
                                            const JointReport& report);

/// What the user has to know of a station's angles, as a sentence; nothing when they hold.
std::optional<std::string> DescribeContradiction(const KnownAngles& angles, const JointProblem& problem);

}  // namespace s2gs
