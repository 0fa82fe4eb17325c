#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

namespace s2gs {

/// A rectangle of a photo in shades of grey.
struct PhotoPart {
  int x = 0;  ///< of its first column and row in the photo [px].
  int y = 0;
  int width = 0;
  int height = 0;
  std::vector<uint8_t> grey;  ///< height * width, from top to bottom.
};

/// The cubic spline through the pixels of a part of a photo: between pixels it neither blurs nor draws
/// features to the pixels' centres, which linear interpolation does by hundredths of a pixel.
/// M. Unser, A. Aldroubi, M. Eden, "B-spline signal processing", 1993.
class SplinePart {
 public:
  /// The part is at least 4 pixels wide and high. What lies beyond its border is taken as mirrored, which its
  /// outermost pixels feel: a value three pixels inside by 2 % of what it would change there.
  explicit SplinePart(const PhotoPart& part);

  /// Whether Value() is defined at a place [px of the photo, COLMAP's convention].
  bool Contains(double x, double y) const {
    return x - x_ >= 1 && y - y_ >= 1 && x - x_ < width_ - 2 && y - y_ < height_ - 2;
  }
  float Value(double x, double y) const;

 private:
  double x_;  // of the centre of the first pixel
  double y_;
  int width_;
  int height_;
  std::vector<float> coefficients_;
};

}  // namespace s2gs
