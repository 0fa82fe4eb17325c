#pragma once

#include <Eigen/Geometry>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "sfm_split/scene/io/colmap_model.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

/// A tripod that is knocked or bends turns its camera about its centre, by as much as the background's
/// picture says and whatever stands where. Here keypoints and poses are taken to the camera as it stood at
/// the station's first photo, so that a station's photos share one pose exactly, and back.
class SteadyCameras {
 public:
  /// \param cameras  the best intrinsics known so far, by id; those of `features` for others, and for photos
  ///     whose picture these move by half a pixel less off the measured one. A wrong focal length is of
  ///     second order: the middle of the picture moves as it was measured.
  SteadyCameras(const ScanFeatures& features, const std::map<uint32_t, Camera>& cameras);

  /// Whether any camera moved.
  bool AnyMoved() const { return any_moved_; }
  /// The largest turn [rad].
  double LargestTurn() const;

  /// The keypoints as the camera of each station's first photo would have seen them.
  ScanFeatures Steady(const ScanFeatures& features) const;
  /// The same for the poses and points2D of a reconstruction of these photos.
  ColmapModel Steady(const ColmapModel& model) const;
  /// Poses and points2D of scene and models as the photos were taken, by the cameras that the scene has now.
  void Shake(AlignedScene* aligned) const;

  bool HasMoved(const std::string& name) const;
  /// Where a photo shows what the steady camera shows at xy [px]; nothing beyond the lens' reach.
  std::optional<Eigen::Vector2d> PhotographedPixel(const std::string& name, const Eigen::Vector2d& xy) const;

 private:
  struct Photo {
    Camera camera;
    Eigen::Quaterniond turn = Eigen::Quaterniond::Identity();  // photo_cam_from_first_cam, by `camera`
    bool has_moved = false;
  };
  Eigen::Vector2d SteadyPixel(const Photo& photo, const Eigen::Vector2d& xy) const;
  Eigen::Quaterniond TurnBy(const Photo& photo, const Camera& camera) const;

  std::map<std::string, Photo> photos_;  // by name
  bool any_moved_ = false;
};

}  // namespace s2gs
