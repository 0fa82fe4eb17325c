#include "s2gs/render_pictures.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>

#include "s2gs/image/photos.h"

namespace s2gs {
namespace {

constexpr int kErrorGain = 4;
constexpr size_t kNumOverviewPhotos = 4;

uint8_t ToByte(float value) { return static_cast<uint8_t>(std::clamp(value, 0.0F, 1.0F) * 255 + 0.5F); }

// A rainbow from red (0) over green to blue (1).
std::array<uint8_t, 3> Rainbow(float t) {
  const auto channel = [t](float middle) { return ToByte(1.5F - std::abs(4 * (t - middle))); };
  return {channel(0.25F), channel(0.5F), channel(0.75F)};
}

}  // namespace

Image8 MaskImage(const PixelMask& mask) {
  Image8 image{mask.width, mask.height, 1, {}};
  image.pixels.reserve(mask.inside.size());
  for (const uint8_t inside : mask.inside) image.pixels.push_back(inside != 0 ? 255 : 0);
  return image;
}

Image8 DepthPicture(const std::vector<float>& depth, int width, int height) {
  float near = 0;
  float far = 0;
  bool any = false;
  for (const float z : depth) {
    if (!(z > 0)) continue;
    near = any ? std::min(near, z) : z;
    far = any ? std::max(far, z) : z;
    any = true;
  }
  Image8 image{width, height, 3, std::vector<uint8_t>(3 * depth.size(), 0)};
  const float range = std::max(far - near, 1e-6F * far);
  for (size_t i = 0; i < depth.size(); ++i) {
    if (!(depth[i] > 0)) continue;
    const std::array<uint8_t, 3> color = Rainbow(0.1F + 0.8F * (depth[i] - near) / range);
    std::copy(color.begin(), color.end(), image.pixels.begin() + static_cast<std::ptrdiff_t>(3 * i));
  }
  return image;
}

Image8 NormalPicture(const RenderedView& view) {
  Image8 image{view.width, view.height, 3, std::vector<uint8_t>(view.normal.size(), 0)};
  for (size_t i = 0; i < view.alpha.size(); ++i) {
    const float* n = view.normal.data() + 3 * i;
    const float length = std::sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    if (view.alpha[i] < 0.5F || !(length > 0)) continue;
    // The camera looks along +z with y down.
    image.pixels[3 * i] = ToByte(0.5F + 0.5F * n[0] / length);
    image.pixels[3 * i + 1] = ToByte(0.5F - 0.5F * n[1] / length);
    image.pixels[3 * i + 2] = ToByte(0.5F - 0.5F * n[2] / length);
  }
  return image;
}

Image8 ForegroundPicture(const RenderedView& view) {
  Image8 image{view.width, view.height, 1, {}};
  image.pixels.reserve(view.foreground.size());
  for (const float p : view.foreground) image.pixels.push_back(ToByte(p));
  return image;
}

std::vector<size_t> OverviewPhotos(size_t num_photos) {
  const size_t count = std::min(kNumOverviewPhotos, num_photos);
  std::vector<size_t> photos;
  photos.reserve(count);
  for (size_t i = 0; i < count; ++i) photos.push_back(i * num_photos / count);
  return photos;
}

Image8 ComparisonPicture(const Image8& photo, const Image8& rendered, const Image8& mask) {
  const int width = rendered.width;
  const int height = rendered.height;
  const Image8 resized = ResizeByArea(photo, width, height);
  Image8 picture{4 * width, height, 3, {}};
  picture.pixels.resize(static_cast<size_t>(12) * width * height);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const bool inside = *mask.Pixel(x, y) > 127;
      for (int c = 0; c < 3; ++c) {
        const int real = resized.Pixel(x, y)[c];
        const int made = rendered.Pixel(x, y)[c];
        picture.Pixel(x, y)[c] = static_cast<uint8_t>(real);
        picture.Pixel(width + x, y)[c] = static_cast<uint8_t>(made);
        picture.Pixel(2 * width + x, y)[c] =
            static_cast<uint8_t>(std::min(255, kErrorGain * std::abs(real - made)));
        picture.Pixel(3 * width + x, y)[c] = static_cast<uint8_t>(inside ? real : real / 4);
      }
    }
  }
  return picture;
}

}  // namespace s2gs
