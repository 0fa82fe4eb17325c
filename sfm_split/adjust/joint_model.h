#pragma once

#include <vector>

#include "sfm_split/adjust/joint_ba.h"
#include "sfm_split/joint_system/joint_solve.h"

namespace s2gs {

// Nested models of what the poses share (JointModel), and whether the data ask for the more general one.

/// Every image with enough of either body gets a camera pose of its own: the object tells all of it but its
/// turn about the axis.
JointProblem WithFreeCameras(const JointProblem& problem, const JointOptions& options);

/// Every image gets a pose of the object of its own.
JointProblem WithFreeObject(const JointProblem& problem);

/// The score part of a test: whether images ask for poses of their own, of the object or of the camera, at
/// the simple model's solution.
void FillScores(const JointProblem& problem, const JointOptions& options, bool of_object, ModelTest* test);

/// Takes the general model when the Bayesian information criterion does.
void CompareModels(const JointSolved& simple, const JointSolved& general, ModelTest* test);

}  // namespace s2gs
