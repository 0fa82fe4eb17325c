#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "sfm_split/scene/camera_model.h"

namespace s2gs {

/// The largest image that a camera may have: that of the image files, which are JPEG's 65500 pixels a side
/// and 268 megapixels. Whatever loops over a camera's pixels or rows ends.
constexpr uint64_t kMaxCameraSide = 65500;
constexpr uint64_t kMaxCameraPixels = uint64_t{1} << 28;

/// Why no photo can be of this camera, as the end of a sentence that begins with it ("has the focal length
/// 0"); nothing when one can: sizes within the bounds above, parameters finite, as many as the model has,
/// focal lengths between a ten-thousandth of the longer side (fields of view of 180 degrees) and ten thousand
/// times it (of 20 seconds of arc), principal points no further away than that.
std::optional<std::string> FindCameraFault(const Camera& camera);

}  // namespace s2gs
