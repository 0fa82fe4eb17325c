#include <algorithm>
#include <cmath>

#include "sfm_split/scene/camera_model.h"
#include "tests/support/synthetic_turntable_parts.h"

namespace s2gs::synthetic {
namespace {

/// All shapes as they stand in the world when an image is taken.
std::vector<Shape> ShapesAt(const SyntheticTurntable& turntable, size_t image) {
  std::vector<Shape> shapes = turntable.room;
  shapes.push_back(turntable.object);
  shapes.back().frame_from_shape =
      turntable.scene.views[image].world_from_object * turntable.object.frame_from_shape;
  shapes.push_back(turntable.platter);
  shapes.back().frame_from_shape =
      turntable.images[image].world_from_platter * turntable.platter.frame_from_shape;
  return shapes;
}

/// The least cosine between a surface's normal and the direction to a camera that still sees its points: flat
/// things may be seen at a low angle, a curved one's rim may not.
double MinCosine(const SyntheticTurntable& turntable, const SyntheticPoint& point) {
  const bool curved =
      point.body == SyntheticBody::kObject && turntable.options.object == SyntheticObject::kBumpy;
  return curved ? 0.2 : 0.05;
}

bool IsVisible(const SyntheticTurntable& turntable, int image, const std::vector<Shape>& shapes,
               const SyntheticPoint& point) {
  const Rigid3 world_from_cam = turntable.scene.views[static_cast<size_t>(image)].cam_from_world.Inverse();
  const Rigid3 world_from_body = world_from_cam * turntable.CamFromBody(image, point.body);
  const Eigen::Vector3d x = world_from_body * point.x;
  const Eigen::Vector3d normal = world_from_body.rotation * point.normal;
  const Ray ray{world_from_cam.translation, x - world_from_cam.translation};
  double cosine = -normal.dot(ray.direction) / ray.direction.norm();
  if (point.two_sided) cosine = std::abs(cosine);
  if (cosine < MinCosine(turntable, point)) return false;
  return std::none_of(shapes.begin(), shapes.end(), [&ray](const Shape& shape) {
    const std::optional<RayHit> hit = Intersect(shape, ray);
    return hit && hit->t < 1 - 1e-6;  // the point's own surface is at 1
  });
}

/// Where a camera sees a point, if that is inside the image.
std::optional<Eigen::Vector2d> ProjectInside(const Camera& camera, const Eigen::Vector3d& x_in_cam) {
  std::optional<Eigen::Vector2d> xy = ProjectToImage(camera, x_in_cam);
  const Eigen::Vector2d size(static_cast<double>(camera.width), static_cast<double>(camera.height));
  if (!xy || (xy->array() < 0).any() || (xy->array() > size.array()).any()) return std::nullopt;
  return xy;
}

/// Removes keypoints at random, of the rotating or of the static ones, until `share` of them rotate.
void ThinOut(double share, RandomNumbers* random, std::vector<SyntheticKeypoint>* keypoints) {
  const auto rotates = [](const SyntheticKeypoint& keypoint) { return IsRotating(keypoint.body); };
  const double rotating = static_cast<double>(std::count_if(keypoints->begin(), keypoints->end(), rotates));
  const double fixed = static_cast<double>(keypoints->size()) - rotating;
  const bool drop_rotating = share < 1 && rotating > share / (1 - share) * fixed;
  auto excess = std::lround(drop_rotating ? rotating - share / (1 - share) * fixed
                                          : fixed - rotating * (1 - share) / share);
  random->Shuffle(keypoints);
  std::vector<SyntheticKeypoint> kept;
  for (const SyntheticKeypoint& keypoint : *keypoints) {
    if (rotates(keypoint) == drop_rotating && excess > 0) {
      --excess;
    } else {
      kept.push_back(keypoint);
    }
  }
  *keypoints = std::move(kept);
}

std::vector<SyntheticKeypoint> KeypointsOf(const SyntheticTurntable& turntable, int image) {
  const SyntheticTurntableOptions& options = turntable.options;
  const Camera& camera = turntable.CameraOf(image);
  const std::vector<Shape> shapes = ShapesAt(turntable, static_cast<size_t>(image));
  RandomNumbers dropout = RandomFor(options.seed, kKeypoints, 4 * static_cast<uint64_t>(image));
  RandomNumbers noise = RandomFor(options.seed, kKeypoints, 4 * static_cast<uint64_t>(image) + 1);
  RandomNumbers order = RandomFor(options.seed, kKeypoints, 4 * static_cast<uint64_t>(image) + 2);
  std::vector<SyntheticKeypoint> keypoints;
  const auto add = [&](const Eigen::Vector2d& exact_xy, SyntheticBody body, int point) {
    SyntheticKeypoint keypoint;
    keypoint.exact_xy = exact_xy;
    keypoint.xy = exact_xy + options.pixel_noise * Eigen::Vector2d(noise.Normal(), noise.Normal());
    keypoint.body = body;
    keypoint.point = point;
    const Eigen::Vector2d& xy = keypoint.xy;
    if (xy.x() >= 0 && xy.y() >= 0 && xy.x() <= options.width && xy.y() <= options.height) {
      keypoints.push_back(keypoint);
    }
  };
  for (size_t i = 0; i < turntable.points.size(); ++i) {
    const SyntheticPoint& point = turntable.points[i];
    const bool dropped = dropout.Uniform() < options.dropout;
    const std::optional<Eigen::Vector2d> xy =
        ProjectInside(camera, turntable.CamFromBody(image, point.body) * point.x);
    if (xy && !dropped && IsVisible(turntable, image, shapes, point)) {
      add(*xy, point.body, static_cast<int>(i));
    }
  }
  if (options.rotating_share > 0) ThinOut(options.rotating_share, &order, &keypoints);
  for (int i = 0; i < options.num_extra_keypoints; ++i) {
    SyntheticKeypoint extra;
    extra.xy = {order.Uniform(0, options.width), order.Uniform(0, options.height)};
    extra.exact_xy = extra.xy;
    keypoints.push_back(extra);
  }
  RandomNumbers watermarks = RandomFor(options.seed, kKeypoints, 3);  // the same for every image
  for (int i = 0; i < options.num_watermarks; ++i) {
    SyntheticKeypoint mark;
    mark.xy = {watermarks.Uniform(0, options.width), watermarks.Uniform(0, options.height)};
    mark.exact_xy = mark.xy;
    mark.body = SyntheticBody::kWatermark;
    mark.point = i;
    keypoints.push_back(mark);
  }
  order.Shuffle(&keypoints);
  return keypoints;
}

using RealDescriptor = std::array<double, 128>;

/// Of norm 512, as COLMAP's are; few large entries and many small ones, as SIFT's gradient histograms have.
SiftDescriptor Quantised(const RealDescriptor& real) {
  double squared_norm = 0;
  for (const double value : real) squared_norm += value * value;
  const double scale = 512 / std::sqrt(squared_norm);
  SiftDescriptor descriptor{};
  for (size_t i = 0; i < descriptor.size(); ++i) {
    descriptor[i] = static_cast<uint8_t>(std::lround(std::min(255.0, scale * real[i])));
  }
  return descriptor;
}

RealDescriptor RandomDescriptor(RandomNumbers random) {
  RealDescriptor descriptor{};
  double squared_norm = 0;
  for (double& value : descriptor) {
    value = -std::log(1 - random.Uniform());
    squared_norm += value * value;
  }
  for (double& value : descriptor) value *= 512 / std::sqrt(squared_norm);
  return descriptor;
}

}  // namespace

void AddKeypoints(SyntheticTurntable* turntable) {
  for (size_t i = 0; i < turntable->images.size(); ++i) {
    turntable->images[i].keypoints = KeypointsOf(*turntable, static_cast<int>(i));
  }
}

void AddDescriptors(SyntheticTurntable* turntable) {
  const SyntheticTurntableOptions& options = turntable->options;
  std::vector<size_t> looks_like(turntable->points.size());
  for (size_t i = 0; i < looks_like.size(); ++i) looks_like[i] = i;
  for (size_t i = 0; i < looks_like.size(); ++i) {
    if (turntable->points[i].twin >= 0) looks_like[static_cast<size_t>(turntable->points[i].twin)] = i;
  }
  for (size_t i = 0; i < turntable->images.size(); ++i) {
    SyntheticImage& image = turntable->images[i];
    RandomNumbers random = RandomFor(options.seed, kDescriptors, 2 * i);
    for (const SyntheticKeypoint& keypoint : image.keypoints) {
      // Odd items: what a point (or, beyond all of those, a watermark) looks like in every image.
      uint64_t look = random.Next() | (1ULL << 40);
      if (keypoint.body == SyntheticBody::kWatermark) {
        look = turntable->points.size() + static_cast<uint64_t>(keypoint.point);
      } else if (keypoint.point >= 0) {
        look = looks_like[static_cast<size_t>(keypoint.point)];
      }
      RealDescriptor real = RandomDescriptor(RandomFor(options.seed, kDescriptors, 2 * look + 1));
      for (double& value : real) value = std::max(0.0, value + options.descriptor_noise * random.Normal());
      image.descriptors.push_back(Quantised(real));
    }
  }
}

}  // namespace s2gs::synthetic
