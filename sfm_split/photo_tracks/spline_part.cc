#include "sfm_split/photo_tracks/spline_part.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

constexpr int kReach = 12;  // pole^12 is a ten-millionth

// From values to the coefficients of the spline through them, in place, along one line of pixels.
void Filter(float* values, int count, int stride) {
  static const float pole = std::sqrt(3.0F) - 2;
  const auto at = [&](int i) -> float& { return values[static_cast<std::ptrdiff_t>(i) * stride]; };
  float sum = 0;
  float power = 1;
  for (int i = 0; i < std::min(count, kReach); ++i, power *= pole) sum += power * at(i);
  at(0) = 6 * sum;
  for (int i = 1; i < count; ++i) at(i) = 6 * at(i) + pole * at(i - 1);
  at(count - 1) = pole / (pole * pole - 1) * (at(count - 1) + pole * at(count - 2));
  for (int i = count - 2; i >= 0; --i) at(i) = pole * (at(i + 1) - at(i));
}

std::array<float, 4> Weights(float t) {
  const float s = 1 - t;
  const float a = s * s * s / 6;
  const float d = t * t * t / 6;
  const float b = 2.0F / 3 - t * t * (2 - t) / 2;
  return {a, b, 1 - a - b - d, d};
}

}  // namespace

SplinePart::SplinePart(const PhotoPart& part)
    : x_(part.x + 0.5),
      y_(part.y + 0.5),
      width_(part.width),
      height_(part.height),
      coefficients_(part.grey.begin(), part.grey.end()) {
  S2GS_INVARIANT(width_ >= 4 && height_ >= 4 &&
                 part.grey.size() == static_cast<size_t>(width_) * static_cast<size_t>(height_));
  for (int y = 0; y < height_; ++y)
    Filter(coefficients_.data() + static_cast<std::ptrdiff_t>(y) * width_, width_, 1);
  for (int x = 0; x < width_; ++x) Filter(coefficients_.data() + x, height_, width_);
}

float SplinePart::Value(double x, double y) const {
  const auto u = static_cast<float>(x - x_);
  const auto v = static_cast<float>(y - y_);
  const auto column = static_cast<int>(u);
  const auto row = static_cast<int>(v);
  const std::array<float, 4> across = Weights(u - static_cast<float>(column));
  const std::array<float, 4> down = Weights(v - static_cast<float>(row));
  const float* line = coefficients_.data() + static_cast<std::ptrdiff_t>(row - 1) * width_ + column - 1;
  float sum = 0;
  for (int i = 0; i < 4; ++i, line += width_) {
    sum += down[i] * (across[0] * line[0] + across[1] * line[1] + across[2] * line[2] + across[3] * line[3]);
  }
  return sum;
}

}  // namespace s2gs
