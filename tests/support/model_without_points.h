#pragma once

#include <cstdint>
#include <string>

#include "sfm_split/scene/io/colmap_model.h"

namespace s2gs {

/// So many photos of one small camera, 1.jpg and on, all in one place, and no points.
inline ColmapModel ModelWithoutPoints(int num_images) {
  ColmapModel model;
  Camera& camera = model.cameras[1];
  camera.camera_id = 1;
  camera.model = CameraModelId::kPinhole;
  camera.width = 40;
  camera.height = 30;
  camera.params = {50, 50, 20, 15};
  for (uint32_t id = 1; id <= static_cast<uint32_t>(num_images); ++id) {
    ColmapImage& image = model.images[id];
    image.image_id = id;
    image.camera_id = 1;
    image.name = std::to_string(id) + ".jpg";
  }
  return model;
}

}  // namespace s2gs
