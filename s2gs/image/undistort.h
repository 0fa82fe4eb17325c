#pragma once

#include <filesystem>

#include "s2gs/image/image_file.h"
#include "sfm_split/base/reporter.h"
#include "sfm_split/scene/camera_model.h"
#include "sfm_split/scene/io/colmap_model.h"

namespace s2gs {

/// Whether its lens turns back within the photo: some pixels of the border show nothing in front of the
/// camera, as where one coefficient was fitted to a strong lens and the object is in the middle.
bool LensTurnsBack(const Camera& camera);

/// The pinhole that images of `camera` are resampled to: its focal lengths, and the largest image that the
/// photo fills whatever the lens, so that no pixel is blank. A camera without distortion stays as it is, but
/// as a PINHOLE. Of a lens that turns back it is the largest box around the principal point that lies within.
/// Throws UserError when the lens leaves no such image, or the model cannot be projected. \param path  the
/// file that the camera comes from, for the message.
Camera UndistortedCamera(const Camera& camera, const std::filesystem::path& path);

/// The image as `pinhole` (of UndistortedCamera) sees it, bilinear between pixels. The result does not depend
/// on the number of threads. Throws Interrupted.
Image8 UndistortImage(const Image8& image, const Camera& camera, const Camera& pinhole, Reporter& reporter);

/// The model with all cameras replaced by UndistortedCamera's and the keypoints moved along.
/// \param path  of the model, for messages.
ColmapModel UndistortedModel(const ColmapModel& model, const std::filesystem::path& path);

}  // namespace s2gs
