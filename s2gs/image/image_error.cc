#include "s2gs/image/image_error.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>

#include "sfm_split/base/error.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {
namespace {

constexpr int kWindow = 11;
constexpr int kRadius = kWindow / 2;
constexpr double kNoFigure = std::numeric_limits<double>::quiet_NaN();

void CheckSameShape(const Image8& a, const Image8& b) {
  S2GS_INVARIANT(a.width == b.width && a.height == b.height && a.channels == b.channels);
  S2GS_INVARIANT(a.channels > 0 && a.width > 0 && a.height > 0);
}

std::array<double, kWindow> GaussianWindow() {
  std::array<double, kWindow> weights{};
  double sum = 0;
  for (int i = 0; i < kWindow; ++i) {
    weights[i] = std::exp(-(i - kRadius) * (i - kRadius) / (2 * 1.5 * 1.5));
    sum += weights[i];
  }
  for (double& weight : weights) weight /= sum;
  return weights;
}

// Moments of both images under the window, side by side.
struct Moments {
  double a = 0, b = 0, aa = 0, bb = 0, ab = 0;

  void Add(double weight, const Moments& m) {
    a += weight * m.a;
    b += weight * m.b;
    aa += weight * m.aa;
    bb += weight * m.bb;
    ab += weight * m.ab;
  }
};

double Similarity(const Moments& m) {
  constexpr double c1 = 0.01 * 0.01;
  constexpr double c2 = 0.03 * 0.03;
  const double var_a = m.aa - m.a * m.a;
  const double var_b = m.bb - m.b * m.b;
  const double covariance = m.ab - m.a * m.b;
  return ((2 * m.a * m.b + c1) * (2 * covariance + c2)) /
         ((m.a * m.a + m.b * m.b + c1) * (var_a + var_b + c2));
}

}  // namespace

int64_t PixelMask::Count() const {
  return std::count_if(inside.begin(), inside.end(), [](uint8_t flag) { return flag != 0; });
}

PixelMask MaskFromImage(const Image8& grey) {
  S2GS_INVARIANT(grey.channels == 1);
  PixelMask mask{grey.width, grey.height, std::vector<uint8_t>(grey.pixels.size())};
  std::transform(grey.pixels.begin(), grey.pixels.end(), mask.inside.begin(),
                 [](uint8_t value) { return static_cast<uint8_t>(value > 127); });
  return mask;
}

PixelMask ResizeNearest(const PixelMask& mask, int width, int height) {
  S2GS_INVARIANT(mask.width > 0 && mask.height > 0 && width > 0 && height > 0);
  // The reciprocal of the rounded ratio, not the ratio itself: the two can round to different columns.
  const double x_step = 1 / (static_cast<double>(width) / mask.width);
  const double y_step = 1 / (static_cast<double>(height) / mask.height);
  PixelMask resized{width, height, std::vector<uint8_t>(static_cast<size_t>(width) * height)};
  for (int y = 0; y < height; ++y) {
    const int source_y = std::min(static_cast<int>(std::floor(y * y_step)), mask.height - 1);
    for (int x = 0; x < width; ++x) {
      const int source_x = std::min(static_cast<int>(std::floor(x * x_step)), mask.width - 1);
      resized.inside[static_cast<size_t>(y) * width + x] =
          mask.inside[static_cast<size_t>(source_y) * mask.width + source_x];
    }
  }
  return resized;
}

PixelMask Widened(const PixelMask& mask, int margin) {
  PixelMask in_rows = {mask.width, mask.height, std::vector<uint8_t>(mask.inside.size(), 0)};
  PixelMask wide = in_rows;
  const size_t width = static_cast<size_t>(mask.width);
  for (int y = 0; y < mask.height; ++y) {
    for (int x = 0; x < mask.width; ++x) {
      if (mask.inside[y * width + x] == 0) continue;
      for (int u = std::max(0, x - margin); u <= std::min(mask.width - 1, x + margin); ++u)
        in_rows.inside[y * width + u] = 1;
    }
  }
  for (int y = 0; y < mask.height; ++y) {
    for (int v = std::max(0, y - margin); v <= std::min(mask.height - 1, y + margin); ++v) {
      for (size_t x = 0; x < width; ++x) wide.inside[v * width + x] |= in_rows.inside[y * width + x];
    }
  }
  return wide;
}

double Psnr(const Image8& image, const Image8& reference, const PixelMask* mask) {
  CheckSameShape(image, reference);
  S2GS_INVARIANT(mask == nullptr || (mask->width == image.width && mask->height == image.height));
  int64_t sum = 0;
  int64_t count = 0;
  for (size_t i = 0; i < image.pixels.size(); ++i) {
    if (mask != nullptr && mask->inside[i / image.channels] == 0) continue;
    const int difference = int{image.pixels[i]} - int{reference.pixels[i]};
    sum += difference * difference;
    ++count;
  }
  if (count == 0) return kNoFigure;
  if (sum == 0) return std::numeric_limits<double>::infinity();
  return 10 * std::log10(255.0 * 255.0 * static_cast<double>(count) / static_cast<double>(sum));
}

double SsimMap::Mean() const {
  if (values.empty()) return kNoFigure;
  return std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
}

double SsimMap::Mean(const PixelMask& mask) const {
  S2GS_INVARIANT(mask.width == width && mask.height == height);
  double sum = 0;
  int64_t count = 0;
  for (size_t i = 0; i < values.size(); ++i) {
    if (mask.inside[i] == 0) continue;
    sum += values[i];
    ++count;
  }
  return count == 0 ? kNoFigure : sum / static_cast<double>(count);
}

double SsimMap::MeanOfValid() const {
  double sum = 0;
  int64_t count = 0;
  for (int y = kRadius; y < height - kRadius; ++y) {
    for (int x = kRadius; x < width - kRadius; ++x) {
      sum += values[static_cast<size_t>(y) * width + x];
      ++count;
    }
  }
  return count == 0 ? kNoFigure : sum / static_cast<double>(count);
}

SsimMap ComputeSsim(const Image8& image, const Image8& reference) {
  CheckSameShape(image, reference);
  const int width = image.width;
  const int height = image.height;
  const int channels = image.channels;
  const std::array<double, kWindow> weights = GaussianWindow();
  SsimMap map{width, height, std::vector<double>(static_cast<size_t>(width) * height)};
  const auto row_values = static_cast<size_t>(width) * channels;

  ParallelFor(height, 0, [&](int64_t row) {
    const auto y = static_cast<int>(row);
    std::vector<Moments> columns(row_values);  // the row, filtered along y only.
    for (int dy = std::max(-kRadius, -y); dy <= std::min(kRadius, height - 1 - y); ++dy) {
      const uint8_t* a_row = image.Pixel(0, y + dy);
      const uint8_t* b_row = reference.Pixel(0, y + dy);
      for (size_t i = 0; i < row_values; ++i) {
        const double a = a_row[i] / 255.0;
        const double b = b_row[i] / 255.0;
        columns[i].Add(weights[dy + kRadius], {a, b, a * a, b * b, a * b});
      }
    }
    for (int x = 0; x < width; ++x) {
      double sum = 0;
      for (int channel = 0; channel < channels; ++channel) {
        Moments moments;
        for (int dx = std::max(-kRadius, -x); dx <= std::min(kRadius, width - 1 - x); ++dx) {
          moments.Add(weights[dx + kRadius], columns[static_cast<size_t>(x + dx) * channels + channel]);
        }
        sum += Similarity(moments);
      }
      map.values[static_cast<size_t>(y) * width + x] = sum / channels;
    }
  });
  return map;
}

MaskOverlap CompareMask(const PixelMask& mask, const Image8& labels, uint8_t object_label, uint8_t disc_label,
                        uint8_t static_label) {
  S2GS_INVARIANT(labels.channels == 1);
  if (mask.width != labels.width || mask.height != labels.height) {
    return CompareMask(ResizeNearest(mask, labels.width, labels.height), labels, object_label, disc_label,
                       static_label);
  }
  int64_t rotating_both = 0, rotating_either = 0, object_both = 0, object_either = 0;
  for (size_t i = 0; i < labels.pixels.size(); ++i) {
    const uint8_t label = labels.pixels[i];
    const bool is_inside = mask.inside[i] != 0;
    const bool is_rotating = label != static_label;
    const bool is_object = label == object_label;
    rotating_both += is_inside && is_rotating;
    rotating_either += is_inside || is_rotating;
    object_both += is_inside && is_object;
    object_either += (is_inside && label != disc_label) || is_object;
  }
  const auto ratio = [](int64_t both, int64_t either) {
    return static_cast<double>(both) / static_cast<double>(std::max<int64_t>(1, either));
  };
  return {ratio(rotating_both, rotating_either), ratio(object_both, object_either)};
}

}  // namespace s2gs
