#include <cstddef>
#include <cstdint>
#include <string_view>

#include "sfm_split/base/error.h"
#include "sfm_split/scene/scene_truth.h"
#include "tests/fuzz/fuzz_seeds.h"

std::vector<std::string> FuzzSeeds() {
  return {R"json({"scene": "seed", "units": "metres", "width": 64, "height": 48, "camera_model": "PINHOLE",
"pixel_convention": "COLMAP: centre of the first pixel at (0.5, 0.5)", "fx": 70.5, "fy": 70.5, "cx": 31.25, "cy": 24,
"axis_point": [1, 2, 0.5], "axis_direction": [0, 0, 2], "mask_values": {"object": 255, "disc": 128, "static": 0},
"images": [{"file": "images/a.jpg", "mask": "gt/masks/a.png", "split": "train", "station": 1, "angle_deg": 0,
"world_to_camera": [[1, 0, 0, 0.5], [0, 0, -1, 0.25], [0, 1, 0, 4], [0, 0, 0, 1]],
"object_to_world": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}]})json"};
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  try {
    s2gs::ParseSceneTruth(std::string_view(reinterpret_cast<const char*>(data), size), "fuzz/gt/scene.json");
  } catch (const s2gs::UserError&) {
  }
  return 0;
}
