#pragma once

#include "sfm_split/base/angles.h"
#include "sfm_split/scene/io/turntable_file.h"

namespace s2gs {

/// A valid turntable.json's content with numbers that need all their digits.
inline TurntableFile ExampleTurntable() {
  TurntableFile file;
  file.axis.point = {0.1, 1.0 / 3, -1e-17};
  file.axis.direction = Eigen::Vector3d(0.1, -0.2, 1).normalized();
  file.num_stations = 3;
  file.scale_observable = true;
  file.units = LengthUnit::kMetre;
  for (int i = 0; i < 4; ++i) {
    TurntableImage image;
    image.name = "station " + std::to_string(i % 3) + "/\xC3\xA4 \"" + std::to_string(i) + "\".jpg";
    image.station = i % 3;
    image.angle_deg = 360.0 * i / 7;
    image.world_from_object.rotation =
        Eigen::AngleAxisd(image.angle_deg * kPi / 180, file.axis.direction) * Eigen::Quaterniond::Identity();
    image.world_from_object.translation = {0.1 * i, -1.0 / 7, 1e5 / 3};
    file.images.push_back(image);
  }
  return file;
}

}  // namespace s2gs
