#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <istream>
#include <limits>
#include <map>
#include <optional>
#include <ostream>
#include <string>
#include <vector>

#include "sfm_split/rigid3.h"
#include "sfm_split/scene.h"

namespace s2gs {

constexpr uint64_t kInvalidPoint3DId = std::numeric_limits<uint64_t>::max();

/// A keypoint of a registered image and the 3D point it sees, if any.
struct ColmapPoint2D {
  Eigen::Vector2d xy = Eigen::Vector2d::Zero();  ///< [px], COLMAP's pixel convention.
  uint64_t point3D_id = kInvalidPoint3DId;
};

struct ColmapImage {
  uint32_t image_id = 0;
  std::string name;  ///< path relative to the image folder.
  uint32_t camera_id = 0;
  Rigid3 cam_from_world;
  std::vector<ColmapPoint2D> points2D;
};

struct ColmapTrackElement {
  uint32_t image_id = 0;
  uint32_t point2D_idx = 0;
};

struct ColmapPoint3D {
  uint64_t point3D_id = kInvalidPoint3DId;
  Eigen::Vector3d xyz = Eigen::Vector3d::Zero();
  Eigen::Matrix<uint8_t, 3, 1> rgb = Eigen::Matrix<uint8_t, 3, 1>::Zero();
  double error = -1;  ///< mean reprojection error [px]; negative when unknown.
  std::vector<ColmapTrackElement> track;
};

/// A sparse model as COLMAP stores it in a folder (cameras, images, points3D; rigs and frames from 3.12 on).
/// Keys are the ids that the values carry.
struct ColmapModel {
  std::map<uint32_t, Camera> cameras;
  std::map<uint32_t, ColmapImage> images;
  std::map<uint64_t, ColmapPoint3D> points3D;
};

}  // namespace s2gs
