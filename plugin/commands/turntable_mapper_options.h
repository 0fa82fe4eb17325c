#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "plugin/cli/options.h"
#include "sfm_split/relocalise/place_scan.h"

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

/// Every option of the command, with what -h says of it.
void AddTurntableMapperOptions(Options& options, TurntableMapperSettings* settings);

}  // namespace s2gs
