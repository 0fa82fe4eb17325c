#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "sfm_split/base/rigid3.h"
#include "sfm_split/pictures/picture_comparison.h"
#include "sfm_split/scene/camera_model.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

/// What a camera that stands still sees while the table turns, and where it may stand.
struct RimView {
  GreyPicture still;      ///< what most of its photos show.
  Camera camera;          ///< of the photos.
  Rigid3 cam_from_world;  ///< as far as it is known: to some degrees.
};

/// Where the rim may be, as far as poses tell that may be wrong by some degrees. Lengths in the poses' unit.
struct RimSearch {
  TurntableAxis axis;
  double low = 0;  ///< of what turns, along the axis from its point.
  double high = 0;
  double radius = 0;  ///< of what turns, from the axis.
};

/// The rim of a round table in a picture.
struct FoundRim {
  std::vector<Eigen::Vector2d> places;  ///< on it, evenly around as far as it shows [px of the photo].
  double sigma_px = 0;                  ///< of each across the rim, as if they erred by themselves.
  double share = 0;         ///< of the directions in which the picture shows its place: those with an edge.
  double false_alarms = 1;  ///< how many such circles are expected by chance.
};

/// The clearest circle whose middle and normal lie near those that the axis has: edges lie along its picture
/// in more directions than edges anywhere would by chance, and in half of them at least. What stands still
/// has no reason to end in a circle about the axis. Nothing when there is none.
std::optional<FoundRim> FindRim(const RimView& view, const RimSearch& search);

}  // namespace s2gs
