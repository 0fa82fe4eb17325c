#pragma once

#include <array>
#include <vector>

#include "s2gs/image/image_file.h"
#include "s2gs/scene/training_scene.h"

namespace s2gs {

/// What automatic exposure and white balance did to photos of cameras that stand still.
struct ExposureSpread {
  int num_photos = 0;   ///< that were changed.
  double least = 1;     ///< gain of a channel that was taken off.
  double greatest = 1;  ///< the same.
};

/// Brings the photos of each camera that stands still to one exposure and white balance, so that a model has
/// one colour to learn: each channel is divided by its gain, the median ratio to what most of the camera's
/// photos show at a pixel, over the pixels that are neither dark nor saturated; gains' logarithms have a mean
/// of zero. Where what turns fills most of the picture, where a camera has fewer than eight photos, and where
/// photos agree to a grey level, photos stay as they are.
ExposureSpread EqualiseExposure(std::vector<ScenePhoto>* photos);

/// A photo as small as exposures are compared in.
Image8 ExposurePicture(const Image8& photo);

/// Logarithms of the gains that EqualiseExposure takes off photos of one camera, by channel; empty: none.
/// \param photos  of one size, or their ExposurePicture.
std::vector<std::array<double, 3>> LogExposureGains(const std::vector<const Image8*>& photos);

/// The same for the photos of one camera, all of one size. Returns whether they were changed.
bool EqualiseExposure(std::vector<Image8>* photos);

}  // namespace s2gs
