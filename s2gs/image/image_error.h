#pragma once

#include <cstdint>
#include <vector>

#include "s2gs/image/image_file.h"

namespace s2gs {

/// Which pixels of an image count: one flag per pixel, rows from top to bottom.
struct PixelMask {
  int width = 0;
  int height = 0;
  std::vector<uint8_t> inside;  ///< 0 or 1; height * width values.

  int64_t Count() const;
};

/// The pixels of a grey image that are brighter than 127: COLMAP's mask convention.
PixelMask MaskFromImage(const Image8& grey);

/// The mask at another size, each pixel taken from the nearest one of the source (the source column of column
/// x is floor(x * source width / width), as in OpenCV's INTER_NEAREST).
PixelMask ResizeNearest(const PixelMask& mask, int width, int height);

/// With every pixel that is at most `margin` rows and columns from one of the mask [px].
PixelMask Widened(const PixelMask& mask, int margin);

/// Peak signal-to-noise ratio [dB] for 8-bit images: 10 log10(255^2 / MSE), the mean over all pixels and
/// channels. Infinite for equal images, NaN when no pixel counts. The images must be of equal size and
/// channels. \param mask  the pixels that count, of the images' size; null: all.
double Psnr(const Image8& image, const Image8& reference, const PixelMask* mask = nullptr);

/// The structural similarity at every pixel, in the variant of the Gaussian-splatting papers (3DGS, 2DGS):
/// Gaussian window of 11 x 11 with sigma 1.5, zeros beyond the border, biased variances, C1 = .01^2 and
/// C2 = .03^2 for values in [0, 1], mean over channels.
struct SsimMap {
  int width = 0;
  int height = 0;
  std::vector<double> values;  ///< height * width.

  /// Over all pixels. NaN when there are none, as for all of these.
  double Mean() const;
  /// Over the pixels of a mask of the same size.
  double Mean(const PixelMask& mask) const;
  /// Over the pixels whose whole window lies inside the image: no influence of the zeros beyond the border.
  double MeanOfValid() const;
};

/// The images must be of equal size and channels.
SsimMap ComputeSsim(const Image8& image, const Image8& reference);

/// How well a mask covers labelled pixels.
struct MaskOverlap {
  double rotating_iou = 0;  ///< mask against every label but static: object and disc.
  double object_iou = 0;    ///< mask against the object, pixels labelled disc left out on both sides.
};

/// Intersection over union; 0 when both are empty.
/// \param mask    resized with ResizeNearest where the sizes differ.
/// \param labels  grey image; `static_label` and `disc_label` as the data set has them, `object_label` the
/// object.
MaskOverlap CompareMask(const PixelMask& mask, const Image8& labels, uint8_t object_label, uint8_t disc_label,
                        uint8_t static_label);

}  // namespace s2gs
