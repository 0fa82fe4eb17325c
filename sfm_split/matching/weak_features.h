#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include "sfm_split/scene/features.h"

namespace s2gs {

/// SIFT features as COLMAP stores them.
struct SiftFeatures {
  Keypoints keypoints;               ///< [px], COLMAP's: the centre of the first pixel is (0.5, 0.5).
  std::vector<float> scales;         ///< [px]
  std::vector<float> orientations;   ///< [radians]
  std::vector<uint8_t> descriptors;  ///< keypoints.size() x 128, the roots of shares of their sum.
};

/// A photo in shades of grey and the part of it that is looked at.
struct GreyRegion {
  int width = 0;  ///< [px]
  int height = 0;
  const uint8_t* grey = nullptr;       ///< height * width
  const uint8_t* is_wanted = nullptr;  ///< height * width, not 0 in the region
};

/// By which share standard deviations of poses fall when features are added to those that are known, all of
/// them of the same noise: these go as one over the root of the number of observations.
inline double GainOfFeatures(double known, double added) {
  return added > 0 ? 1 - std::sqrt(known / (known + added)) : 0;
}

/// A gain that is not worth matching again: what a part of a scan that is left out may cost at most.
constexpr double kLeastFeatureGain = 0.01;

/// Finds features of little contrast in a region of a photo: all extrema that noise does not make, at four
/// standard deviations of what it makes. Noise is measured in the photo.
/// \param known         features that are there already: none of the same place and size is found again.
/// \param known_scales  of theirs, or empty.
/// \param max_features  those of the largest contrast are kept.
SiftFeatures FindWeakFeatures(const GreyRegion& photo, const Keypoints& known,
                              const std::vector<float>& known_scales, int max_features);

}  // namespace s2gs
