#include "s2gs/rotating_mask.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "s2gs/kernel/foreground.h"
#include "s2gs/kernel/sh.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

// Lengths are in radii of the rotating part.
constexpr double kRimQuantile = 0.98;    // of the radii: the few beyond are strays.
constexpr double kRim = 0.9;             // from this radius on a Gaussian is one of the rim.
constexpr double kBinHeight = 0.01;      // in which the rim's lower end is looked for.
constexpr double kMinShare = 5e-4;       // of the Gaussians: a bin with fewer of the rim is empty,
constexpr size_t kMinInBin = 4;          // and with fewer than these.
constexpr double kMaxShareBelow = 0.05;  // more Gaussians below the rim: it is no disc's.
constexpr float kMinOpacity = 0.3F;      // fainter ones lie anywhere.
constexpr double kSweptMargin = 0.01;    // of the radius.
constexpr double kSideInner = 0.95;      // the side is between these radii,
constexpr double kSideOuter = 1.02;
constexpr double kSideColorAbove = 0.06;  // has the colour of the rotating ones up to this above its end,
constexpr double kSideAbove = 0.08;       // and reaches from this above
constexpr double kSideBelow = 0.04;       // to this below the end.
constexpr size_t kMinOnSide = 5;          // rotating Gaussians, for a colour.
constexpr float kColorTolerance = 0.1F;
constexpr float kAnyColor = 1e6F;          // a tolerance that all colours keep.
constexpr double kMaxUprightCosine = 0.7;  // between the axis and the normal of a Gaussian on a side.
constexpr double kMinUprightShare =
    0.85;  // of the static Gaussians' area on the side: else they are the ground.

// A rotating Gaussian about the axis.
struct RingPlace {
  double radius;
  double height;
  Vec3<float> color;
};

std::vector<RingPlace> RotatingPlaces(const TurntableAxis& axis, const Gaussians& gaussians) {
  std::vector<RingPlace> places;
  places.reserve(gaussians.size());
  for (size_t i = 0; i < gaussians.size(); ++i) {
    if (!IsForeground(gaussians.foreground_logit[i])) continue;
    if (Sigmoid(gaussians.opacity_logit[i]) < kMinOpacity) continue;
    const float* x = gaussians.centre.data() + 3 * i;
    const float* dc = gaussians.sh_dc.data() + 3 * i;
    const Eigen::Vector3d from_point = Eigen::Vector3d(x[0], x[1], x[2]) - axis.point;
    const double height = from_point.dot(axis.direction);
    const double radius = (from_point - height * axis.direction).norm();
    if (!std::isfinite(radius)) continue;
    places.push_back({radius, height, ShBaseColor(Vec3<float>{dc[0], dc[1], dc[2]})});
  }
  return places;
}

// The lowest height from which on the rim has enough Gaussians, or nothing when they are too many below.
std::optional<double> RimEnd(const std::vector<RingPlace>& places, double radius) {
  std::vector<double> rim;
  rim.reserve(places.size());
  for (const RingPlace& place : places) {
    if (place.radius > kRim * radius) rim.push_back(place.height);
  }
  const size_t needed =
      std::max(kMinInBin, static_cast<size_t>(kMinShare * static_cast<double>(places.size())));
  std::sort(rim.begin(), rim.end());
  for (size_t i = 0; i + needed <= rim.size(); ++i) {
    if (rim[i + needed - 1] - rim[i] > kBinHeight * radius) continue;
    const double end = rim[i];
    const auto below = std::count_if(places.begin(), places.end(),
                                     [&](const RingPlace& place) { return place.height < end; });
    if (static_cast<double>(below) > kMaxShareBelow * static_cast<double>(places.size())) return std::nullopt;
    return end;
  }
  return std::nullopt;
}

// Whether the static Gaussians on the side stand as it does. The ground around a disc of its colour lies.
bool StaticOnesAreUpright(const RotatingSide& side, const Gaussians& gaussians) {
  RenderRequest request;
  request.side = side;
  const AxisTube<float> tube = SelectionOf(request).side;
  double area = 0;
  double upright = 0;
  for (size_t i = 0; i < gaussians.size(); ++i) {
    if (IsForeground(gaussians.foreground_logit[i])) continue;
    const float* x = gaussians.centre.data() + 3 * i;
    const float* dc = gaussians.sh_dc.data() + 3 * i;
    const Vec3<float> color = ShBaseColor(Vec3<float>{dc[0], dc[1], dc[2]});
    if (!Contains(tube, Vec3<float>{x[0], x[1], x[2]}, color)) continue;
    const float* q = gaussians.rotation.data() + 4 * i;
    const Eigen::Vector3d normal =
        Eigen::Quaterniond(q[0], q[1], q[2], q[3]).normalized() * Eigen::Vector3d::UnitZ();
    const double weight = Sigmoid(gaussians.opacity_logit[i]) *
                          std::exp(double{gaussians.log_scale[2 * i]} + gaussians.log_scale[2 * i + 1]);
    area += weight;
    if (std::abs(normal.dot(side.region.axis.direction)) < kMaxUprightCosine) upright += weight;
  }
  return area > 0 && upright >= kMinUprightShare * area;
}

std::optional<RotatingSide> FindSide(const Gaussians& gaussians, const std::vector<RingPlace>& places,
                                     const TurntableAxis& axis, double radius, double end) {
  std::array<std::vector<float>, 3> colors;
  for (std::vector<float>& channel : colors) channel.reserve(places.size());
  for (const RingPlace& place : places) {
    if (place.radius < kSideInner * radius || place.height > end + kSideColorAbove * radius) continue;
    colors[0].push_back(place.color.x);
    colors[1].push_back(place.color.y);
    colors[2].push_back(place.color.z);
  }
  if (colors[0].size() < kMinOnSide) return std::nullopt;
  RotatingSide side;
  side.region = {axis, kSideOuter * radius, end - kSideBelow * radius, end + kSideAbove * radius};
  side.inner_radius = kSideInner * radius;
  for (int c = 0; c < 3; ++c) side.color[c] = Quantile(colors[c], 0.5);
  side.color_tolerance = kColorTolerance;
  if (!StaticOnesAreUpright(side, gaussians)) return std::nullopt;
  return side;
}

}  // namespace

std::optional<RotatingShape> FindRotatingShape(const TrainingScene& scene, const Gaussians& gaussians) {
  if (!scene.region) return std::nullopt;
  RotatingShape shape;
  shape.swept = *scene.region;
  const TurntableAxis& axis = scene.region->axis;
  const std::vector<RingPlace> places = RotatingPlaces(axis, gaussians);
  if (places.empty()) return shape;
  std::vector<double> radii;
  radii.reserve(places.size());
  for (const RingPlace& place : places) radii.push_back(place.radius);
  const double radius = Quantile(radii, kRimQuantile);
  const std::optional<double> end = RimEnd(places, radius);
  if (!end) return shape;
  shape.swept.radius = std::min(shape.swept.radius, (1 + kSweptMargin) * radius);
  shape.swept.low = std::max(shape.swept.low, *end);
  shape.side = FindSide(gaussians, places, axis, radius, *end);
  return shape;
}

std::vector<uint32_t> FindReachingOut(const RotatingRegion& region, const Gaussians& gaussians) {
  const auto is_out = [&](const Eigen::Vector3d& x) {
    return (x - region.axis.point).cross(region.axis.direction).norm() > region.radius;
  };
  std::vector<uint32_t> reaching;
  for (size_t i = 0; i < gaussians.size(); ++i) {
    if (!IsForeground(gaussians.foreground_logit[i])) continue;
    const float* x = gaussians.centre.data() + 3 * i;
    const float* q = gaussians.rotation.data() + 4 * i;
    const Eigen::Vector3d centre(x[0], x[1], x[2]);
    const Eigen::Matrix3d axes = Eigen::Quaterniond(q[0], q[1], q[2], q[3]).normalized().toRotationMatrix();
    const auto leads_out = [&](int axis) {
      const Eigen::Vector3d tip = std::exp(double{gaussians.log_scale[2 * i + axis]}) * axes.col(axis);
      return is_out(centre + tip) || is_out(centre - tip);
    };
    if (leads_out(0) || leads_out(1)) reaching.push_back(static_cast<uint32_t>(i));
  }
  return reaching;
}

std::vector<uint32_t> FindRotatingIn(const RotatingRegion& region, double margin,
                                     const Placement& gaussians) {
  std::vector<uint32_t> inside;
  for (size_t i = 0; i < gaussians.size(); ++i) {
    const float* x = gaussians.centre.data() + 3 * i;
    if (IsForeground(gaussians.foreground_logit[i]) && region.Contains({x[0], x[1], x[2]}, margin))
      inside.push_back(static_cast<uint32_t>(i));
  }
  return inside;
}

void CountTableAsRotating(const TableRim& table, RotatingShape* shape) {
  shape->side.emplace();
  shape->side->region = table.region;
  shape->side->color_tolerance = kAnyColor;
}

RenderRequest MaskRequest(const TrainingScene& scene, const std::optional<RotatingShape>& shape,
                          const PinholeView& view) {
  RenderRequest request;
  request.view = view;
  // A scene where nothing turns has Gaussians of the object too, by where they are.
  request.bodies = scene.mode == TrainMode::kMasks ? SceneBodies::kObjectOnly : SceneBodies::kBoth;
  request.foreground = true;
  request.hard_foreground = true;
  if (scene.mode != TrainMode::kS2gs) return request;
  if (IsOneStation(scene)) {
    request.drawn = DrawnBody::kForeground;
  } else if (shape) {
    request.without_static = shape->swept;
    request.side = shape->side;
  }
  return request;
}

PixelMask RotatingMask(const RenderedView& view) {
  PixelMask mask{view.width, view.height, {}};
  mask.inside.reserve(view.foreground.size());
  for (const float value : view.foreground) mask.inside.push_back(value > 0.5F ? 1 : 0);
  return mask;
}

}  // namespace s2gs
