#pragma once

#include <vector>

#include "sfm_split/joint_system/joint_priors.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

/// An image's table angle as it came out, and where the image stands in its station's order of capture.
struct AngleAtPlace {
  int image = 0;
  int place = 0;
  double angle_rad = 0;
};

/// The equal steps nearest to a station's angles, in the order of their places; those that make one whole
/// turn over its photos to within half a step are that turn's. A few angles may be anywhere. The width is
/// open. No places where the angles are too few or no steps.
/// \param num_photos  with and without an angle.
EqualStepsPrior NearestEqualSteps(const std::vector<AngleAtPlace>& angles, int num_photos);

struct StepsFinding {
  /// Per station whose steps may be equal; images are those of the features.
  std::vector<EqualStepsPrior> steps;
  /// Images whose matches, right ones beside wrong ones, are surer of another place than chance explains.
  std::vector<int> elsewhere;
};

/// How closely table angles that are taken for equal steps lie about them, by what the matches themselves say
/// and not by angles that somebody adjusted: each photo in turn is moved about the axis from its place among
/// equal steps, all others stand at theirs, and its deviation, normal with the width, is integrated over; one
/// photo in ten may be anywhere. The width is the mean of its posterior between .01 degrees (better than
/// keypoints tell) and one, all orders of magnitude alike before: .21 where matches tell nothing. It is that
/// of the table and so one for all stations: where a station's matches tell nothing, the others' do. A
/// station of which far more photos than that tenth stand elsewhere has no equal steps.
/// \param cameras, views  of each image of the features; null without a pose.
/// \param risk  that chance puts a photo elsewhere, for all of them together.
StepsFinding StepsByMatches(const ScanFeatures& features, const std::vector<const Camera*>& cameras,
                            const std::vector<const View*>& views, const TurntableAxis& axis, double risk);

}  // namespace s2gs
