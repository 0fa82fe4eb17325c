#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "sfm_split/base/rigid3.h"

namespace s2gs {

/// A camera's pose against the object, as the object's points tell it.
struct PoseByPoints {
  Rigid3 cam_from_object;
  int inliers = 0;
  int candidates = 0;
};

/// The pose of a camera from points and where it sees them, by random samples and SQPnP over their inliers.
/// Nothing when fewer than `least` agree, or when those that agree do not tell a pose: they lie on one spot
/// or on one line, or their picture is no larger than the errors allowed.
/// \param in_object     in any unit of length.
/// \param in_plane      where they are seen, in the plane at `focal` in front of the camera [px].
/// \param max_error_px  of a point that agrees.
std::optional<PoseByPoints> FitPoseByPoints(const std::vector<Eigen::Vector3d>& in_object,
                                            const std::vector<Eigen::Vector2d>& in_plane, double focal,
                                            double max_error_px, int least);

}  // namespace s2gs
