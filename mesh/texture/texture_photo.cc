#include "mesh/texture/texture_photo.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <utility>

#include "s2gs/image/photos.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

// Steeper surfaces are smeared over too few pixels.
constexpr float kMinCosine = 0.1F;
// How far behind the rendered surface a point still lies on it, in pixels at its depth, beside what its slope
// explains over a pixel and a half: the coarseness of the mesh.
constexpr float kDepthTolerance = 2;
constexpr float kSlopeReach = 1.5F;
// A step in depth of more pixels between neighbours is an edge that something stands in front of: a surface
// that turns 80 degrees away makes steps of 5.7.
constexpr float kStepPixels = 6;
// Within so many pixels of a border a photo counts less.
constexpr float kFadePixels = 8;
// What is left of its weight at the border: enough where no other photo shows the place.
constexpr float kLeastFade = 1e-3F;
// The smoothed photo is this much smaller: shading stays in it, texture does not.
constexpr int kShrink = 4;
// Blocks of the smoothed photo whose depths differ by more pixels show different surfaces: one that turns 63
// degrees away makes steps of two for each of a block's pixels.
constexpr float kBlockStepPixels = 2 * kShrink;
constexpr float kLeastBlockShare = 0.05F;
// Around the mesh [px].
constexpr int kMargin = 2 * kShrink;

int Third(float pixels) { return static_cast<int>(std::lround(3 * pixels)); }

// Distances to the nearest 0 in thirds of a pixel, straight 3 and diagonal 4 (Borgefors, "Distance
// transformations in digital images", 1986). Beyond the image there are no zeros.
void SpreadDistances(int width, int height, std::vector<uint8_t>* distances) {
  const auto relax = [&](int x, int y, int dx, int dy, int step) {
    if (x + dx < 0 || x + dx >= width || y + dy < 0 || y + dy >= height) return;
    uint8_t& own = (*distances)[static_cast<size_t>(y) * width + x];
    const int other = (*distances)[static_cast<size_t>(y + dy) * width + x + dx] + step;
    if (other < own) own = static_cast<uint8_t>(other);
  };
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      relax(x, y, -1, 0, 3);
      relax(x, y, -1, -1, 4);
      relax(x, y, 0, -1, 3);
      relax(x, y, 1, -1, 4);
    }
  }
  for (int y = height - 1; y >= 0; --y) {
    for (int x = width - 1; x >= 0; --x) {
      relax(x, y, 1, 0, 3);
      relax(x, y, 1, 1, 4);
      relax(x, y, 0, 1, 3);
      relax(x, y, -1, 1, 4);
    }
  }
}

// Of the pixels before, at, after and after next, for a place between the second and the third: Keys, "Cubic
// convolution interpolation for digital image processing", 1981. A mean of neighbours would be blurred.
std::array<float, 4> CubicWeights(float t) {
  const float u = 1 - t;
  return {-0.5F * t * u * u, 1 + t * t * (1.5F * t - 2.5F), 1 + u * u * (1.5F * u - 2.5F), -0.5F * u * t * t};
}

// At a place counted from the centre of the first pixel, which lies between two pixels or on one.
void SampleCubic(const Image8& image, float x, float y, std::array<uint8_t, 3>* rgb) {
  x = std::clamp(x, 0.0F, static_cast<float>(image.width - 1));
  y = std::clamp(y, 0.0F, static_cast<float>(image.height - 1));
  const int x0 = std::min(static_cast<int>(x), image.width - 2);
  const int y0 = std::min(static_cast<int>(y), image.height - 2);
  const std::array<float, 4> across = CubicWeights(x - static_cast<float>(x0));
  const std::array<float, 4> down = CubicWeights(y - static_cast<float>(y0));
  std::array<float, 3> sum = {};
  for (int j = 0; j < 4; ++j) {
    const int row = std::clamp(y0 + j - 1, 0, image.height - 1);
    for (int i = 0; i < 4; ++i) {
      const uint8_t* pixel = image.Pixel(std::clamp(x0 + i - 1, 0, image.width - 1), row);
      for (int c = 0; c < 3; ++c) sum[c] += down[j] * across[i] * static_cast<float>(pixel[c]);
    }
  }
  for (int c = 0; c < 3; ++c) (*rgb)[c] = static_cast<uint8_t>(std::clamp(sum[c], 0.0F, 255.0F) + 0.5F);
}

}  // namespace

TexturePhoto::TexturePhoto(const ObjectView& view, const Image8& photo, const Image8& mask,
                           const TriangleMesh& mesh)
    : rotation_(view.cam_from_object.rotation.toRotationMatrix().cast<float>()),
      translation_(view.cam_from_object.translation.cast<float>()),
      center_(CameraCentre(view.cam_from_object).cast<float>()),
      focal_(static_cast<float>(view.fx), static_cast<float>(view.fy)) {
  S2GS_INVARIANT(photo.channels == 3 && photo.width == view.width && photo.height == view.height);
  // Of the photo only what shows the mesh is kept.
  Eigen::AlignedBox2d box;
  bool is_behind = false;
  for (const Eigen::Vector3f& vertex : mesh.vertices) {
    const Eigen::Vector3d x = view.cam_from_object * vertex.cast<double>();
    if (x.z() > 0) {
      box.extend(Eigen::Vector2d(view.fx * x.x() / x.z() + view.cx, view.fy * x.y() / x.z() + view.cy));
    } else {
      is_behind = true;
    }
  }
  ImagePart part{0, 0, photo.width, photo.height};
  if (!is_behind && !box.isEmpty()) {
    const auto range = [](double low, double high, int size, int* first, int* count) {
      const double begin = std::clamp(std::floor(low) - kMargin, 0.0, size - 2.0);
      const double end = std::clamp(std::ceil(high) + kMargin, begin + 2, static_cast<double>(size));
      *first = static_cast<int>(begin);
      *count = static_cast<int>(end - begin);
    };
    range(box.min().x(), box.max().x(), photo.width, &part.x, &part.width);
    range(box.min().y(), box.max().y(), photo.height, &part.y, &part.height);
  }
  first_x_ = part.x;
  first_y_ = part.y;
  color_ = CutAndShrink(photo, part, 1);
  ObjectView own = view;
  own.width = part.width;
  own.height = part.height;
  own.cx -= part.x;
  own.cy -= part.y;
  principal_ = {static_cast<float>(own.cx), static_cast<float>(own.cy)};
  inverse_depths_ = RasterizeMesh(mesh.vertices, mesh.triangles, own, false).inverse_depths;
  FindBorders(view, mask);
  Smooth();
}

void TexturePhoto::FindBorders(const ObjectView& view, const Image8& mask) {
  const int width = color_.width;
  const int height = color_.height;
  const float step = kStepPixels / std::max(focal_.x(), focal_.y());
  border_distances_.assign(inverse_depths_.size(), static_cast<uint8_t>(Third(kFadePixels)));
  const auto is_outside = [&](int x, int y) {
    if (mask.pixels.empty()) return false;
    const auto column = static_cast<int64_t>(x + first_x_) * mask.width / view.width;
    const auto row = static_cast<int64_t>(y + first_y_) * mask.height / view.height;
    return *mask.Pixel(static_cast<int>(column), static_cast<int>(row)) < 128;
  };
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const size_t at = static_cast<size_t>(y) * width + x;
      const float inverse = inverse_depths_[at];
      const bool is_edge_of_photo = x + first_x_ == 0 || y + first_y_ == 0 ||
                                    x + first_x_ == view.width - 1 || y + first_y_ == view.height - 1;
      if (is_edge_of_photo || inverse == 0 || is_outside(x, y)) {
        border_distances_[at] = 0;
        continue;
      }
      // The farther side of a step is what the nearer one may hide.
      const auto is_behind = [&](int dx, int dy) {
        if (x + dx < 0 || x + dx >= width || y + dy < 0 || y + dy >= height) return false;
        return inverse_depths_[at + static_cast<std::ptrdiff_t>(dy) * width + dx] > inverse * (1 + step);
      };
      if (is_behind(-1, 0) || is_behind(1, 0) || is_behind(0, -1) || is_behind(0, 1))
        border_distances_[at] = 0;
    }
  }
  SpreadDistances(width, height, &border_distances_);
}

void TexturePhoto::Smooth() {
  // Means over blocks, of one surface alone: neither the background nor what stands in front must bleed in.
  const int width = std::max(2, (color_.width + kShrink - 1) / kShrink);
  const int height = std::max(2, (color_.height + kShrink - 1) / kShrink);
  const size_t count = static_cast<size_t>(width) * height;
  std::vector<Eigen::Vector4f> sums(count, Eigen::Vector4f::Zero());
  smooth_inverse_depths_.assign(count, 0);
  std::vector<float> depths;
  for (int block = 0; block < static_cast<int>(count); ++block) {
    const int begin_x = block % width * kShrink;
    const int begin_y = block / width * kShrink;
    const auto for_each = [&](const auto& use) {
      for (int y = begin_y; y < std::min(begin_y + kShrink, color_.height); ++y) {
        for (int x = begin_x; x < std::min(begin_x + kShrink, color_.width); ++x) {
          const size_t at = static_cast<size_t>(y) * color_.width + x;
          if (border_distances_[at] > 0) use(x, y, inverse_depths_[at]);
        }
      }
    };
    depths.clear();
    for_each([&](int, int, float inverse_depth) { depths.push_back(inverse_depth); });
    if (depths.empty()) continue;
    const float middle = UpperMedian(depths);
    smooth_inverse_depths_[block] = middle;
    for_each([&](int x, int y, float inverse_depth) {
      if (!IsSameSurface(inverse_depth, middle)) return;
      const uint8_t* rgb = color_.Pixel(x, y);
      sums[block] += Eigen::Vector4f(rgb[0], rgb[1], rgb[2], 1);
    });
  }
  smooth_ = {width, height, 3, std::vector<uint8_t>(3 * count, 0)};
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const float own = smooth_inverse_depths_[static_cast<size_t>(y) * width + x];
      if (own == 0) continue;
      Eigen::Vector4f sum = Eigen::Vector4f::Zero();
      for (int dy = -1; dy <= 1; ++dy) {
        for (int dx = -1; dx <= 1; ++dx) {
          if (x + dx < 0 || x + dx >= width || y + dy < 0 || y + dy >= height) continue;
          const size_t at = static_cast<size_t>(y + dy) * width + x + dx;
          const int binomial = (2 - std::abs(dx)) * (2 - std::abs(dy));
          if (IsSameSurface(smooth_inverse_depths_[at], own)) sum += static_cast<float>(binomial) * sums[at];
        }
      }
      for (int c = 0; c < 3; ++c) {
        smooth_.Pixel(x, y)[c] = static_cast<uint8_t>(std::lround(sum[c] / sum[3]));
      }
    }
  }
}

bool TexturePhoto::IsSameSurface(float inverse_depth1, float inverse_depth2) const {
  if (inverse_depth1 == 0 || inverse_depth2 == 0) return false;
  const float step = kBlockStepPixels / std::max(focal_.x(), focal_.y());
  return std::abs(inverse_depth1 / inverse_depth2 - 1) <= step;
}

bool TexturePhoto::SampleSmooth(const Eigen::Vector2f& p, float inverse_depth,
                                std::array<uint8_t, 3>* rgb) const {
  const float x = std::clamp(p.x() / kShrink - 0.5F, 0.0F, static_cast<float>(smooth_.width - 1));
  const float y = std::clamp(p.y() / kShrink - 0.5F, 0.0F, static_cast<float>(smooth_.height - 1));
  const int x0 = std::min(static_cast<int>(x), smooth_.width - 2);
  const int y0 = std::min(static_cast<int>(y), smooth_.height - 2);
  Eigen::Array4f sum = Eigen::Array4f::Zero();
  for (int i = 0; i < 4; ++i) {
    const int column = x0 + i % 2;
    const int row = y0 + i / 2;
    if (!IsSameSurface(smooth_inverse_depths_[static_cast<size_t>(row) * smooth_.width + column],
                       inverse_depth)) {
      continue;
    }
    const float weight =
        (1 - std::abs(x - static_cast<float>(column))) * (1 - std::abs(y - static_cast<float>(row)));
    const uint8_t* pixel = smooth_.Pixel(column, row);
    sum += weight * Eigen::Array4f(pixel[0], pixel[1], pixel[2], 1);
  }
  // Of a sliver of a block there is nothing to go by.
  if (sum[3] < kLeastBlockShare) return false;
  for (int c = 0; c < 3; ++c) (*rgb)[c] = static_cast<uint8_t>(sum[c] / sum[3] + 0.5F);
  return true;
}

bool TexturePhoto::Sample(const Eigen::Vector3f& x_in_object, const Eigen::Vector3f& normal,
                          PhotoSample* sample) const {
  const Eigen::Vector3f to_camera = center_ - x_in_object;
  const float distance = to_camera.norm();
  const float cosine = normal.dot(to_camera) / distance;
  if (!(cosine > kMinCosine)) return false;
  const Eigen::Vector3f x = rotation_ * x_in_object + translation_;
  if (!(x.z() > 0)) return false;
  const Eigen::Vector2f p = focal_.cwiseProduct(x.head<2>()) / x.z() + principal_;
  // Between centres of pixels, so that all four around are there.
  const float column = p.x() - 0.5F;
  const float row = p.y() - 0.5F;
  if (!(column >= 0 && row >= 0 && column <= static_cast<float>(color_.width - 1) &&
        row <= static_cast<float>(color_.height - 1))) {
    return false;
  }
  const int x0 = std::min(static_cast<int>(column), color_.width - 2);
  const int y0 = std::min(static_cast<int>(row), color_.height - 2);
  const size_t at = static_cast<size_t>(y0) * color_.width + x0;
  const size_t below = at + color_.width;
  // The farthest of the pixels around: where it is much farther than the nearest, the border is near.
  const float farthest = std::min(std::min(inverse_depths_[at], inverse_depths_[at + 1]),
                                  std::min(inverse_depths_[below], inverse_depths_[below + 1]));
  const float slope = std::sqrt(std::max(0.0F, 1 - cosine * cosine)) / cosine;
  const float tolerance = (kDepthTolerance + kSlopeReach * slope) / std::max(focal_.x(), focal_.y());
  if (x.z() * farthest > 1 + tolerance) return false;
  const size_t nearest = static_cast<size_t>(p.y()) * color_.width + static_cast<size_t>(p.x());
  if (border_distances_[nearest] == 0) return false;
  const float along = std::min(1.0F, static_cast<float>(border_distances_[nearest]) / (3 * kFadePixels));
  const float fade = std::max(kLeastFade, along * along * (3 - 2 * along));
  sample->weight = fade * (cosine - kMinCosine) * focal_.x() * focal_.y() / (x.z() * x.z());
  SampleCubic(color_, column, row, &sample->color);
  return SampleSmooth(p, 1 / x.z(), &sample->smooth);
}

}  // namespace s2gs
