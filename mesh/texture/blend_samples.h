#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "mesh/texture/texture_photo.h"

namespace s2gs {

/// A photo's sample of a texel.
struct TexelCandidate {
  PhotoSample sample;
  uint16_t photo = 0;
};

/// The best samples of one texel: so many at most, in a row of an array.
constexpr int kMaxCandidates = 10;

/// Puts a sample among the best; `count` of them are there.
void AddCandidate(const TexelCandidate& candidate, TexelCandidate* candidates, uint8_t* count);

/// What makes photos comparable.
struct PhotoTone {
  Eigen::Array3f gain = Eigen::Array3f::Ones();  ///< of each channel: the photo's colours times it.
  float sharpness = 1;                           ///< of its texture, beside that of other photos.
};

/// What all photos show of a texel, those too that are not among its candidates.
struct SeenColor {
  Eigen::Array3f sum = Eigen::Array3f::Zero();  ///< of smooth colours with their gains, by weight.
  float weight = 0;

  void Add(const PhotoSample& sample, const PhotoTone& tone, float share = 1);
};

struct BlendedColor {
  Eigen::Array3f color = Eigen::Array3f::Zero();  ///< sRGB.
  /// How many times as strong the light in `color` is as that without `shades`.
  Eigen::Array3f light = Eigen::Array3f::Ones();
};

/// The colour of a texel: in two bands (Baumberg, "Blending images for texturing 3D models", BMVC 2002). What
/// is smooth is a mean over all photos, so that no photo ends visibly; the detail is taken from few, those
/// that show the place largest and sharpest, so that it stays sharp. Photos whose smooth colour is far from
/// the others' median (gloss, something in front that the mesh lacks) do not count. The colour is then put
/// under the light in which photos show the place: the smooth colour is `seen`'s mean, which with weights
/// that are areas in the photos is the one colour that is nearest to all their pixels.
/// \param shades  the light that the place gets in each candidate's photo (turn_light.h): photos agree
///                without it.
/// \param count   at least 1.
/// \param seen    has the candidates' photos in it.
BlendedColor BlendSamples(const TexelCandidate* candidates, const Eigen::Array3f* shades, int count,
                          const std::vector<PhotoTone>& tones, const SeenColor& seen);

}  // namespace s2gs
