#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <map>
#include <string>

#include "s2gs/core/pinhole_view.h"
#include "s2gs/image/image_file.h"
#include "sfm_split/base/reporter.h"
#include "sfm_split/scene/camera_model.h"

namespace s2gs {

/// The image at another size: every pixel is the mean of the source over the area that it covers, which for
/// enlarging is the nearest pixel with blended borders. Both sides must be at least 1.
Image8 ResizeByArea(const Image8& image, int width, int height);

/// A rectangle of pixels.
struct ImagePart {
  int x = 0;
  int y = 0;
  int width = 0;
  int height = 0;
};

/// The part, which lies within the image, at 1 / factor of its size: every pixel is the mean of factor x
/// factor of the image's, so that `x_in_part = (x_in_image - part.x) / factor` to the last pixel. What is
/// left over at the right and at the bottom is cut off; the part must be no smaller than the factor.
Image8 CutAndShrink(const Image8& image, const ImagePart& part, int factor);

/// How a photo of a camera with distortion becomes one of a pinhole.
struct Undistortion {
  Camera source;
  Camera pinhole;  ///< as UndistortedCamera makes it.
};

/// Throws like UndistortedCamera (undistort.h).
/// \param path  the file that the camera comes from, for the message.
Undistortion PlanUndistortion(const Camera& camera, const std::filesystem::path& path);

/// The plans of all photos of a model, by name. Throws like PlanUndistortion and ReadColmapModel.
std::map<std::string, Undistortion> PlanUndistortions(const std::filesystem::path& model_folder);

/// The inverse for a mask: of the pinhole's size, or smaller, to the source camera's. Outside of what the
/// pinhole sees the nearest pixel counts. Throws Interrupted.
Image8 DistortMask(const Undistortion& plan, const Image8& mask, Reporter& reporter);

/// A view of the pinhole camera's intrinsics, without poses.
PinholeView ViewOfPinhole(const Camera& pinhole);

/// The view through the same camera at another image size.
PinholeView ResizeView(const PinholeView& view, int width, int height);

}  // namespace s2gs
