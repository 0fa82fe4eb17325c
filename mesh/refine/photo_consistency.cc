#include "mesh/refine/photo_consistency.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "s2gs/image/photos.h"
#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

// Standard deviation of a grey value that no texture explains: sensor, JPEG, resampling.
constexpr float kGreyNoise = 2;
// Photos further apart than this are no better for it [rad].
constexpr float kEnoughParallax = 0.26F;
// Less than this, and a photo adds nothing [rad, times the cosine].
constexpr float kLeastParallax = 1e-3F;

// Light stands still while the object turns: how brightness slopes across a patch is partly shading, which
// differs between photos and pulls smooth bodies inwards, and partly texture. So much of the slope comes off.
// All of it takes the edges of printed pictures along (tests/bench/notes/refinement.md).
constexpr float kShadingShare = 0.5F;

// Takes the mean and a share of the slope off and scales to length 1, less where noise is a part of it.
// \return  the length.
float Normalise(float* values) {
  constexpr int kHalf = kPatchSide / 2;
  // Squares of a column's number, counted from the middle, over the whole patch.
  constexpr int kSlopeSquares = kPatchSide * (kHalf * (kHalf + 1) * (2 * kHalf + 1) / 3);
  float mean = 0;
  float slope_u = 0;
  float slope_v = 0;
  for (int k = 0, j = -kHalf; j <= kHalf; ++j) {
    for (int i = -kHalf; i <= kHalf; ++i, ++k) {
      mean += values[k];
      slope_u += static_cast<float>(i) * values[k];
      slope_v += static_cast<float>(j) * values[k];
    }
  }
  mean /= kPatchSize;
  slope_u *= kShadingShare / kSlopeSquares;
  slope_v *= kShadingShare / kSlopeSquares;
  float square = 0;
  for (int k = 0, j = -kHalf; j <= kHalf; ++j) {
    for (int i = -kHalf; i <= kHalf; ++i, ++k) {
      values[k] -= mean + slope_u * static_cast<float>(i) + slope_v * static_cast<float>(j);
      square += values[k] * values[k];
    }
  }
  const float scale = 1 / std::sqrt(square + kPatchSize * kGreyNoise * kGreyNoise);
  for (int i = 0; i < kPatchSize; ++i) values[i] *= scale;
  return std::sqrt(square) * scale;
}

}  // namespace

PhotoPyramid::PhotoPyramid(const ObjectView& view, Image8 grey)
    : rotation_(view.cam_from_object.rotation.toRotationMatrix().cast<float>()),
      translation_(view.cam_from_object.translation.cast<float>()),
      center_(CameraCentre(view.cam_from_object).cast<float>()),
      focal_(static_cast<float>(std::max(view.fx, view.fy))) {
  S2GS_INVARIANT(grey.channels == 1 && grey.width == view.width && grey.height == view.height);
  S2GS_INVARIANT(grey.width >= 2 && grey.height >= 2);
  levels_.reserve(kNumLevels);
  const auto add = [&](Image8 image, double scale) {
    levels_.push_back(
        {std::move(image),
         {static_cast<float>(view.fx * scale), static_cast<float>(view.fy * scale)},
         {static_cast<float>(view.cx * scale - 0.5), static_cast<float>(view.cy * scale - 0.5)}});
  };
  add(std::move(grey), 1);
  for (int level = 1; level < kNumLevels; ++level) {
    const Image8& last = levels_.back().grey;
    if (last.width < 4 || last.height < 4) return;
    Image8 half = CutAndShrink(last, {0, 0, last.width, last.height}, 2);
    add(std::move(half), std::ldexp(1, -level));
  }
}

float PhotoPyramid::PixelSize(const Eigen::Vector3f& x_in_object) const {
  return (rotation_.row(2).dot(x_in_object) + translation_.z()) / focal_;
}

void PhotoPyramid::SamplePatch(const Eigen::Vector3f& middle, const Eigen::Vector3f& u,
                               const Eigen::Vector3f& v, int level, float* values) const {
  const Level& at = levels_[std::min<size_t>(level, levels_.size() - 1)];
  const Image8& image = at.grey;
  const Eigen::Vector3f x = rotation_ * middle + translation_;
  const float inverse_depth = 1 / std::max(x.z(), std::numeric_limits<float>::min());
  const Eigen::Vector2f ray = x.head<2>() * inverse_depth;
  const Eigen::Vector2f start = at.focal.cwiseProduct(ray) + at.principal;
  // The patch is so small that its projection is affine.
  const auto image_step = [&](const Eigen::Vector3f& step) -> Eigen::Vector2f {
    const Eigen::Vector3f in_camera = rotation_ * step;
    return at.focal.cwiseProduct(in_camera.head<2>() - ray * in_camera.z()) * inverse_depth;
  };
  const Eigen::Vector2f along_u = image_step(u);
  const Eigen::Vector2f along_v = image_step(v);
  // One value below the last, so that there is a neighbour to the right and below.
  const float max_x = static_cast<float>(image.width - 1) - 1e-3F;
  const float max_y = static_cast<float>(image.height - 1) - 1e-3F;
  constexpr int kHalf = kPatchSide / 2;
  int k = 0;
  for (int j = -kHalf; j <= kHalf; ++j) {
    for (int i = -kHalf; i <= kHalf; ++i, ++k) {
      const auto a = static_cast<float>(i);
      const auto b = static_cast<float>(j);
      // In this order a coordinate that is not a number becomes 0.
      const float px = std::min(std::max(0.0F, start.x() + a * along_u.x() + b * along_v.x()), max_x);
      const float py = std::min(std::max(0.0F, start.y() + a * along_u.y() + b * along_v.y()), max_y);
      const int column = static_cast<int>(px);
      const int row = static_cast<int>(py);
      const float fx = px - static_cast<float>(column);
      const float fy = py - static_cast<float>(row);
      const uint8_t* grey = image.Pixel(column, row);
      const float top = grey[0] + fx * static_cast<float>(grey[1] - grey[0]);
      const uint8_t* below = grey + image.width;
      const float bottom = below[0] + fx * static_cast<float>(below[1] - below[0]);
      values[k] = top + fy * (bottom - top);
    }
  }
}

float SurfacePatch::PixelSize() const {
  float size = std::numeric_limits<float>::infinity();
  for (int i = 0; i < num_views; ++i) size = std::min(size, views[i]->PixelSize(middle));
  return size;
}

void SelectPhotos(const std::vector<const PhotoPyramid*>& candidates, int max_views, SurfacePatch* patch) {
  S2GS_INVARIANT(max_views <= SurfacePatch::kMaxViews);
  struct Candidate {
    Eigen::Vector3f direction;
    float cosine;
    float parallax;  // least angle to a photo that is taken
  };
  std::vector<Candidate> from;
  from.reserve(candidates.size());
  for (const PhotoPyramid* photo : candidates) {
    const Eigen::Vector3f direction = (photo->center() - patch->middle).normalized();
    from.push_back({direction, patch->normal.dot(direction), kEnoughParallax});
  }
  patch->num_views = 0;
  while (patch->num_views < max_views) {
    size_t best = 0;
    float best_value = kLeastParallax;
    for (size_t i = 0; i < from.size(); ++i) {
      const float value = from[i].cosine * from[i].parallax;
      if (value <= best_value) continue;
      best_value = value;
      best = i;
    }
    if (best_value <= kLeastParallax) return;
    patch->views[patch->num_views] = candidates[best];
    patch->cosines[patch->num_views++] = from[best].cosine;
    const Eigen::Vector3f taken = from[best].direction;
    for (Candidate& candidate : from) {
      const float angle = 2 * std::asin(std::min(1.0F, (candidate.direction - taken).norm() / 2));
      candidate.parallax = std::min(candidate.parallax, angle);
    }
  }
}

void ConsistencyCurve(const SurfacePatch& patch, int level, float step, int max_steps, float* curve) {
  const float spacing = patch.PixelSize() * static_cast<float>(1 << level);
  const Eigen::Vector3f u_direction = patch.normal.unitOrthogonal();
  const Eigen::Vector3f u = spacing * u_direction;
  const Eigen::Vector3f v = spacing * patch.normal.cross(u_direction);
  float weight = 0;
  float weight_squares = 0;
  for (int i = 0; i < patch.num_views; ++i) {
    weight += patch.cosines[i];
    weight_squares += patch.cosines[i] * patch.cosines[i];
  }
  for (int offset = -max_steps; offset <= max_steps; ++offset) {
    const Eigen::Vector3f middle = patch.middle + static_cast<float>(offset) * step * patch.normal;
    std::array<float, kPatchSize> sum{};
    float self = 0;
    for (int i = 0; i < patch.num_views; ++i) {
      std::array<float, kPatchSize> values{};
      patch.views[i]->SamplePatch(middle, u, v, level, values.data());
      const float length = patch.cosines[i] * Normalise(values.data());
      self += length * length;
      for (int k = 0; k < kPatchSize; ++k) sum[k] += patch.cosines[i] * values[k];
    }
    // The square of a sum is the sum of all products: those of a photo with itself come off.
    float all = 0;
    for (const float value : sum) all += value * value;
    curve[offset + max_steps] = (all - self) / (weight * weight - weight_squares);
  }
}

}  // namespace s2gs
