#include "sfm_split/scene/camera_check.h"

#include <algorithm>
#include <cmath>

#include "sfm_split/base/text_reader.h"

namespace s2gs {

std::optional<std::string> FindCameraFault(const Camera& camera) {
  // Of the longer side: a field of view of .006 degrees; a typing error, not a lens.
  constexpr double kMaxRatio = 1e4;
  const CameraModelInfo& info = InfoOf(camera.model);
  if (camera.params.size() != info.NumParams()) {
    return "has " + std::to_string(camera.params.size()) + " parameters, the model " +
           std::string(info.name) + " takes " + std::to_string(info.NumParams());
  }
  if (camera.width < 1 || camera.width > kMaxCameraSide || camera.height < 1 ||
      camera.height > kMaxCameraSide || camera.width * camera.height > kMaxCameraPixels) {
    return "has images of " + std::to_string(camera.width) + " x " + std::to_string(camera.height) +
           " pixels; the bounds are " + std::to_string(kMaxCameraSide) + " a side and " +
           std::to_string(kMaxCameraPixels) + " in all";
  }
  for (const double param : camera.params) {
    if (!std::isfinite(param)) return "has a parameter that is not finite";
  }
  const auto number = [](double value) {
    std::string text;
    AppendNumber(value, &text);
    return text;
  };
  const auto side = static_cast<double>(std::max(camera.width, camera.height));
  for (size_t i = 0; i < info.num_focal_params; ++i) {
    const double focal = camera.params[i];
    if (!(focal > 0)) return "has the focal length " + number(focal) + ", it must be positive";
    if (focal > kMaxRatio * side || focal * kMaxRatio < side) {
      return "has the focal length " + number(focal) + ", which no lens has for images of " + number(side) +
             " pixels";
    }
  }
  for (size_t i = info.num_focal_params; i < info.FirstExtraParam(); ++i) {
    if (std::abs(camera.params[i]) > kMaxRatio * side) {
      return "has a principal point at " + number(camera.params[i]) + ", far from images of " + number(side) +
             " pixels";
    }
  }
  return std::nullopt;
}

}  // namespace s2gs
