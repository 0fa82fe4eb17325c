#pragma once

#include <Eigen/Core>
#include <utility>
#include <vector>

#include "sfm_split/base/rigid3.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

/// A point of the object, and where an image may show it.
struct PointInImage {
  Eigen::Vector3d x_in_object = Eigen::Vector3d::Zero();
  Eigen::Vector2d xy = Eigen::Vector2d::Zero();  ///< [px]
};

struct TableAngleFit {
  bool found = false;
  double angle_rad = 0;  ///< in (-pi, pi]
  int inliers = 0;       ///< points within the error bound.
  double support = 0;    ///< sum of 1 - (error / bound)^2 over them.
  double margin = 0;     ///< support over that of the best other angle, 5 degrees or more away.
};

/// The turn of the table at one image whose camera is known: the one unknown that is left. A point on its
/// circle about the axis meets its keypoint's ray at one angle: each proposes, all vote by reprojection,
/// Gauss-Newton refines. Found when at least `min_inliers` agree. \param axis  the object's frame is the
/// world's at angle 0.
TableAngleFit FitTableAngle(const Camera& camera, const Rigid3& cam_from_world, const TurntableAxis& axis,
                            const std::vector<PointInImage>& points, double max_error_px, int min_inliers);

/// A keypoint of the image and its match in another image whose pose is known.
struct MatchInPosedImage {
  Eigen::Vector2d xy = Eigen::Vector2d::Zero();  ///< [px]
  const Camera* other_camera = nullptr;
  Rigid3 other_cam_from_object;
  Eigen::Vector2d other_xy = Eigen::Vector2d::Zero();  ///< [px]
};

/// The same from matches alone, where too few of them see points yet: each proposes the two angles at which
/// its rays meet, all vote by Sampson's error. Matches with an image of the same camera place propose one
/// angle only.
TableAngleFit FitTableAngle(const Camera& camera, const Rigid3& cam_from_world, const TurntableAxis& axis,
                            const std::vector<MatchInPosedImage>& matches, double max_error_px,
                            int min_inliers);

/// A match between an image of one body and an image of another that is turned against it.
struct MatchAcrossTurn {
  const Camera* camera = nullptr;
  Rigid3 cam_from_world;
  Eigen::Vector2d xy = Eigen::Vector2d::Zero();  ///< [px]
  const Camera* other_camera = nullptr;
  Rigid3 other_cam_from_object;
  Eigen::Vector2d other_xy = Eigen::Vector2d::Zero();  ///< [px]
};

/// The one turn about the axis, common to all matches, at which their rays meet: FitTableAngle for matches of
/// several images.
TableAngleFit FitTurn(const TurntableAxis& axis, const std::vector<MatchAcrossTurn>& matches,
                      double max_error_px, int min_inliers);

/// How many of the matches meet at a turn.
struct TurnSupport {
  double score = 0;  ///< sum of 1 - (error / bound)^2.
  int inliers = 0;
};
TurnSupport SupportOfTurn(const TurntableAxis& axis, const std::vector<MatchAcrossTurn>& matches,
                          double max_error_px, double angle_rad);

}  // namespace s2gs
