#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "sfm_split/placement/place_scan.h"

namespace s2gs {

/// What turntable_mapper is told.
struct TurntableMapperSettings {
  std::filesystem::path workspace_path;
  std::filesystem::path image_path;
  std::filesystem::path colmap_path;
  int max_attempts = 3;
  std::vector<std::string> mapper_options;
  std::filesystem::path angles_path;
  double step_deg = 0;
  bool adjust_to_photos = true;
  bool circle_first = true;
  PlacementOptions placement;
};

}  // namespace s2gs
