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

// On a true surface more than one pair of photos in so many is alike, whatever moves over it.
constexpr int kAlikePairs = 5;

// Light stands still while the object turns: how brightness slopes across a patch is partly shading, which
// differs between photos and pulls smooth bodies inwards, and partly texture. So much of the slope comes off.
// All of it takes the edges of printed pictures along (tests/bench/notes/refinement.md).
constexpr float kShadingShare = 0.5F;

// What slopes along u and along v across the patch's points, without their mean: at right angles to each
// other and of length 1.
class Slopes {
 public:
  explicit Slopes(const SurfacePatch& patch) : size_(patch.num_points) {
    S2GS_INVARIANT(size_ >= kLeastPatchPoints);
    for (int k = 0; k < size_; ++k) {
      u_[k] = patch.points[k].x();
      v_[k] = patch.points[k].y();
    }
    TakeMeanOff(&u_);
    TakeMeanOff(&v_);
    Scale(1 / std::sqrt(Dot(u_, u_)), &u_);
    const float shared = Dot(u_, v_);
    for (int k = 0; k < size_; ++k) v_[k] -= shared * u_[k];
    Scale(1 / std::sqrt(Dot(v_, v_)), &v_);
  }

  // Takes the mean and a share of the slope off and scales to length 1, less where noise is a part of it.
  // \return  the length.
  float Normalise(std::array<float, kPatchSize>* values) const {
    TakeMeanOff(values);
    const float slope_u = kShadingShare * Dot(u_, *values);
    const float slope_v = kShadingShare * Dot(v_, *values);
    for (int k = 0; k < size_; ++k) (*values)[k] -= slope_u * u_[k] + slope_v * v_[k];
    const float square = Dot(*values, *values);
    const float scale = 1 / std::sqrt(square + static_cast<float>(size_) * kGreyNoise * kGreyNoise);
    Scale(scale, values);
    return std::sqrt(square) * scale;
  }

 private:
  using Values = std::array<float, kPatchSize>;

  float Dot(const Values& a, const Values& b) const {
    float sum = 0;
    for (int k = 0; k < size_; ++k) sum += a[k] * b[k];
    return sum;
  }
  void Scale(float factor, Values* values) const {
    for (int k = 0; k < size_; ++k) (*values)[k] *= factor;
  }
  void TakeMeanOff(Values* values) const {
    float mean = 0;
    for (int k = 0; k < size_; ++k) mean += (*values)[k];
    mean /= static_cast<float>(size_);
    for (int k = 0; k < size_; ++k) (*values)[k] -= mean;
  }

  int size_;
  Values u_{};
  Values v_{};
};

// Of a patch's photos with each other.
class Comparison {
 public:
  explicit Comparison(const SurfacePatch& patch) : patch_(patch), slopes_(patch) {
    for (int i = 0; i < patch.num_views; ++i) {
      weight_ += patch.cosines[i];
      weight_squares_ += patch.cosines[i] * patch.cosines[i];
    }
  }

  PatchAgreement At(const Eigen::Vector3f& middle, int level) const {
    std::array<float, kPatchSize> sum{};
    float self = 0;
    for (int i = 0; i < patch_.num_views; ++i) {
      std::array<float, kPatchSize> values{};
      patch_.views[i]->SamplePatch(patch_, middle, level, values.data());
      const float length = patch_.cosines[i] * slopes_.Normalise(&values);
      self += length * length;
      for (int k = 0; k < kPatchSize; ++k) sum[k] += patch_.cosines[i] * values[k];
    }
    // The square of a sum is the sum of all products: those of a photo with itself come off.
    float all = 0;
    for (const float value : sum) all += value * value;
    return {(all - self) / (weight_ * weight_ - weight_squares_), self / weight_squares_};
  }

 private:
  const SurfacePatch& patch_;
  const Slopes slopes_;
  float weight_ = 0;
  float weight_squares_ = 0;
};

// \param p  counted from the centre of the first pixel.
float GreyOf(const Image8& image, const Eigen::Vector2f& p) {
  // One value below the last, so that there is a neighbour to the right and below.
  const float max_x = static_cast<float>(image.width - 1) - 1e-3F;
  const float max_y = static_cast<float>(image.height - 1) - 1e-3F;
  // In this order a coordinate that is not a number becomes 0.
  const float px = std::min(std::max(0.0F, p.x()), max_x);
  const float py = std::min(std::max(0.0F, p.y()), max_y);
  const int column = static_cast<int>(px);
  const int row = static_cast<int>(py);
  const float fx = px - static_cast<float>(column);
  const float fy = py - static_cast<float>(row);
  const uint8_t* grey = image.Pixel(column, row);
  const float top = grey[0] + fx * static_cast<float>(grey[1] - grey[0]);
  const uint8_t* below = grey + image.width;
  const float bottom = below[0] + fx * static_cast<float>(below[1] - below[0]);
  return top + fy * (bottom - top);
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

float PhotoPyramid::GreyAt(const Eigen::Vector3f& x_in_object) const {
  const Level& finest = levels_.front();
  const Eigen::Vector3f x = rotation_ * x_in_object + translation_;
  const Eigen::Vector2f ray = x.head<2>() / std::max(x.z(), std::numeric_limits<float>::min());
  return GreyOf(finest.grey, finest.focal.cwiseProduct(ray) + finest.principal);
}

void PhotoPyramid::SamplePatch(const SurfacePatch& patch, const Eigen::Vector3f& middle, int level,
                               float* values) const {
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
  const Eigen::Vector2f along_u = image_step(patch.spacing * patch.u);
  const Eigen::Vector2f along_v = image_step(patch.spacing * patch.v);
  const Eigen::Vector2f along_normal = image_step(patch.spacing * patch.normal);
  for (int k = 0; k < patch.num_points; ++k) {
    const Eigen::Vector3f& point = patch.points[k];
    const Eigen::Vector2f p = start + point.x() * along_u + point.y() * along_v + point.z() * along_normal;
    values[k] = GreyOf(image, p);
  }
}

void SurfacePatch::LayFlat(int level) {
  constexpr int kHalf = kPatchSide / 2;
  spacing = PixelSize() * static_cast<float>(1 << level);
  u = normal.unitOrthogonal();
  v = normal.cross(u);
  num_points = 0;
  for (int j = -kHalf; j <= kHalf; ++j) {
    for (int i = -kHalf; i <= kHalf; ++i) {
      points[num_points++] = {static_cast<float>(i), static_cast<float>(j), 0.0F};
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
  const Comparison comparison(patch);
  for (int offset = -max_steps; offset <= max_steps; ++offset) {
    const Eigen::Vector3f middle = patch.middle + static_cast<float>(offset) * step * patch.normal;
    curve[offset + max_steps] = comparison.At(middle, level).correlation;
  }
}

bool PhotosDisagree(const SurfacePatch& patch, float least_texture) {
  const Slopes slopes(patch);
  std::array<std::array<float, kPatchSize>, SurfacePatch::kMaxViews> values{};
  std::array<float, SurfacePatch::kMaxViews> lengths{};
  int count = 0;  // of the photos that show texture
  for (int i = 0; i < patch.num_views; ++i) {
    patch.views[i]->SamplePatch(patch, patch.middle, 0, values[count].data());
    lengths[count] = slopes.Normalise(&values[count]);
    count += lengths[count] * lengths[count] > least_texture ? 1 : 0;
  }
  if (count < 2 || 2 * count < patch.num_views) return false;
  int num_alike = 0;
  for (int i = 0; i < count; ++i) {
    for (int j = 0; j < i; ++j) {
      float product = 0;
      for (int k = 0; k < patch.num_points; ++k) product += values[i][k] * values[j][k];
      // Noise is in the lengths, and in their scale once more: of a share t of texture and noise, both photos
      // have 2 t - 1 in common.
      num_alike += product >= lengths[i] * lengths[j] - 0.5F ? 1 : 0;
    }
  }
  return kAlikePairs * num_alike < count * (count - 1) / 2;
}

PatchAgreement MeasureAgreement(const SurfacePatch& patch) { return Comparison(patch).At(patch.middle, 0); }

}  // namespace s2gs
