#pragma once

#include <cstdint>
#include <vector>

#include "mesh/texture/blend_samples.h"

namespace s2gs {

/// What one photo shows at one of the places at which all photos are compared.
struct ToneSample {
  uint32_t place = 0;
  uint16_t photo = 0;
  PhotoSample sample;
  /// The place's light in the photo beside its mean (turn_light.h): gains are found without it.
  Eigen::Array3f shade = Eigen::Array3f::Ones();
};

/// Gains and sharpness of photos from what they show of the same places. Gains are those that make each
/// photo's smooth colours the others' median: exposure and white balance that changed from photo to photo.
/// Their logarithms have the mean 0 in each channel. The sharpness is the median strength of a photo's detail
/// beside the mean of all photos that show the place. Photos that share too few places keep gain and
/// sharpness 1.
/// \param samples      places in ascending order.
/// \param num_threads  0: one for each core. The result does not depend on it.
std::vector<PhotoTone> EstimateTones(const std::vector<ToneSample>& samples, int num_photos,
                                     int num_threads = 0);

}  // namespace s2gs
