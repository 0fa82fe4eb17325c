#pragma once

#include <Eigen/Core>
#include <vector>

#include "sfm_split/photo_tracks/track_places.h"
#include "sfm_split/pictures/picture_comparison.h"

namespace s2gs {

/// The outline, in one photo, of what turns before its camera: of what differs from what the camera shows in
/// most photos, without holes. Shadows on what stands still belong to it, and so may what the thing hides in
/// most of the photos.
struct Silhouette {
  /// Distances from the outline are known up to this [px of the picture]; farther ones are cut off here.
  static constexpr float kReachPx = 4;

  int width = 0;  ///< of the picture, at most kPictureSidePx [px].
  int height = 0;
  Eigen::Vector2d photo_px = Eigen::Vector2d::Ones();  ///< pixels of the photo per pixel of the picture.
  /// height * width: distance from the outline [px of the picture], positive inside; empty when not found.
  std::vector<float> inside;
  /// Places on the outline, a pixel inside, where the thing itself hides what is behind it, and no
  /// shadow does. [px of the photo, COLMAP's convention]
  std::vector<Eigen::Vector2d> rim;

  bool IsFound() const { return !inside.empty(); }

  /// How far a place of the photo lies outside [px of the picture], from 0 (inside, or beyond the picture's
  /// border, where nothing is known) to kReachPx.
  float Outside(const Eigen::Vector2d& xy) const;
};

/// A picture of at most kPictureSidePx of a photo.
GreyPicture PictureOf(const GreyPhoto& photo);

/// The outlines in a station's photos. \param pictures  of one camera that stood still, of one size; shake
/// has been taken off. \param max_rim  places on an outline.
std::vector<Silhouette> FindSilhouettes(const std::vector<GreyPicture>& pictures, int max_rim);

}  // namespace s2gs
