#pragma once

#include <cstdint>
#include <filesystem>

#include "plugin/cli/options.h"
#include "plugin/shared_options/backend_choice.h"
#include "s2gs/view_maps.h"

namespace s2gs {

/// What depth maps, normal maps and silhouettes show.
enum class MapsOf : uint8_t { kObject, kAll };

/// Whose a table's top is where photos do not tell whether it turns.
enum class PlainTable : uint8_t { kObject, kBackground };

/// What gaussian_renderer is told.
struct RendererArguments {
  std::filesystem::path workspace_path;
  std::filesystem::path image_path;
  std::filesystem::path model_path;
  std::filesystem::path output_path;
  std::filesystem::path image_list;
  bool color = false;
  bool foreground = false;
  bool masks = true;
  bool stereo = true;
  bool pictures = false;
  bool comparison = false;
  bool overview = true;
  DepthKind depth = DepthKind::kMedian;
  MapsOf maps_of = MapsOf::kObject;
  bool undistort_always = false;
  PlainTable plain_table = PlainTable::kObject;
  bool cut_at_table = true;
  bool clear_plain_top = true;
  bool table_seen = true;
  int32_t num_frames = 0;
  int32_t frame_station = 0;
  BackendChoice backend;
};

/// Adds all of them, those of the backend too.
void AddRendererOptions(Options* options, RendererArguments* arguments);

}  // namespace s2gs
