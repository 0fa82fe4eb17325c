#pragma once

#include <cstddef>

#include "s2gs/image/image_file.h"

namespace s2gs {

/// How much pictures that one camera took from one place differ where nothing has changed.
struct PictureNoise {
  float of_grey = 0;  ///< standard deviation of a pixel [grey levels].
  float tolerance =
      0;  ///< of the most different channel of two pictures: three deviations, light's drift in it.
};

/// From the picture's halves in the order taken, so that what turns has moved on: most of a picture stands
/// still, and half of the differences are noise alone. At least half a grey level, of rounding.
/// \param pictures  RGB, of one size; at least two.
PictureNoise MeasurePictureNoise(const Image8* pictures, size_t count);

/// The largest difference of the three channels of two pixels.
float MostDifferentChannel(const uint8_t* a, const uint8_t* b);

/// How steep a picture is at a pixel: its slopes along both axes, by central differences, added [grey levels
/// per px].
/// \param x, y  not at the image's border.
float SlopeAt(const Image8& image, int x, int y);

/// Of the patches whose texture is measured [px].
constexpr int kTextureRadius = 3;

/// Standard deviation of the grey values about a pixel, without their slope: so shading and the soft borders
/// of shadows are plain. \param x, y  further than `radius` from the image's border.
/// \param radius  of the patch [px], at least 1.
float TextureAt(const Image8& image, int x, int y, int radius = kTextureRadius);

/// The standard deviation of what is texture, at the least, in that of what it is told from.
constexpr float kTextureFactor = 2;
/// The least that is texture and not noise [grey levels].
float LeastTexture(const PictureNoise& noise);

}  // namespace s2gs
