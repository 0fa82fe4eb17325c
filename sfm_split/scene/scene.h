#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <vector>

#include "sfm_split/base/rigid3.h"
#include "sfm_split/scene/camera_model.h"

namespace s2gs {

/// One photo of an aligned turntable scene. cam_from_object() == cam_from_world * world_from_object.
struct View {
  std::string name;  ///< path of the photo relative to the image folder.
  uint32_t camera_id = 0;
  int station = 0;           ///< photos of one station share cam_from_world up to small shake.
  double angle_deg = 0;      ///< turn of the table since the reference image, about +axis [degrees].
  Rigid3 cam_from_world;     ///< the world is the static background's frame; z along the axis.
  Rigid3 world_from_object;  ///< the paper's F_t; identity at the reference image.

  Rigid3 CamFromObject() const { return cam_from_world * world_from_object; }
};

/// The line that the table turns about, in the world frame.
struct TurntableAxis {
  Eigen::Vector3d point = Eigen::Vector3d::Zero();
  Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();  ///< of unit length.
};

enum class LengthUnit { kSfm, kMetre };

/// An aligned turntable scene without its points: what turntable.json and the two sparse models say together.
struct TurntableScene {
  std::vector<Camera> cameras;
  std::vector<View> views;  ///< by name.
  /// Name of the view at which the object's frame is the world's; who takes it out names another and moves
  /// the object's frame along.
  std::string reference;
  TurntableAxis axis;
  int num_stations = 0;
  bool scale_observable = false;  ///< false with one station: background depth is then undefined.
  LengthUnit units = LengthUnit::kSfm;

  /// The reference view; the first one where none is named so; null without views.
  const View* Reference() const {
    for (const View& view : views) {
      if (view.name == reference) return &view;
    }
    return views.empty() ? nullptr : views.data();
  }

  /// Null where there is none.
  const Camera* FindCamera(uint32_t camera_id) const {
    for (const Camera& camera : cameras) {
      if (camera.camera_id == camera_id) return &camera;
    }
    return nullptr;
  }
};

}  // namespace s2gs
