#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "sfm_split/scene/camera_model.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

/// A place on the rim of the table's disc in a photo.
struct RimSighting {
  const Camera* camera = nullptr;
  Rigid3 cam_from_world;
  Eigen::Vector2d xy = Eigen::Vector2d::Zero();  ///< [px]
};

/// The rim as a circle about the table's axis.
struct DiscRim {
  double radius = 0;  ///< in the scene's unit.
  double height = 0;  ///< along the axis from its point.
  double sigma = 0;   ///< standard deviation of the radius.
  double rms_px = 0;  ///< of the sightings' distances from the circle; 0 from two of them.
};

/// The circle about the axis that the rim's places lie on, by least squares in pixels. They need not be the
/// same places in different photos, since the disc turns in itself; two unknowns need two places, of which
/// one should be nearer to the camera than the axis and one beyond it, or photos from two heights.
/// \param click_px  standard deviation of each coordinate of a place; what they disagree by counts if larger.
/// \return  nothing when fewer than two places are there, or they do not tell radius from height.
std::optional<DiscRim> FitDiscRim(const TurntableAxis& axis, const std::vector<RimSighting>& sightings,
                                  double click_px);

}  // namespace s2gs
