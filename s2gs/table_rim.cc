#include "s2gs/table_rim.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>

#include "s2gs/kernel/foreground.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/binomial_tail.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

// How the surface is looked at.
constexpr int kDirections = 36;  // so few that neighbours see different pieces of an edge.
constexpr int kSteps = 120;
constexpr double kReach = 4;              // in radii of the rotating part: a small thing on a large table.
constexpr double kNearReach = 1.2;        // in radii of the rim, to measure it.
constexpr double kDistance = 4;           // of the eye, in reaches: nearly straight from above.
constexpr double kRadiusQuantile = 0.98;  // of the rotating part's radii: the few beyond are strays.
// Which heights are looked at.
constexpr double kBinHeight = 0.02;      // [radii of the rotating part]
constexpr double kMinLevelCosine = 0.9;  // between the axis and the normal of a level Gaussian.
constexpr double kMinPeakShare = 0.1;    // of the largest level area at one height: a surface.
constexpr float kMinOpacity = 0.3F;      // fainter ones lie anywhere.
constexpr double kNear = 3;              // in tolerances: where the surface's own height may be.
// What a rim is.
constexpr int kApart = 2;             // [steps], about an edge, which a rendering softens.
constexpr double kDeviations = 3;     // of the surface's own changes of colour: an edge.
constexpr double kMinRimShare = 0.7;  // a square's soft sides make up half of the directions.
constexpr double kMinSideShare = 0.5;
constexpr double kMaxFalseAlarms = 1e-3;
// How its side is looked at.
constexpr double kMinFacing = 0.5;  // cosine between a direction and that to some camera: its side is seen.
constexpr int kMinSideDirections = 6;
constexpr double kNearlyAll = 0.9;
constexpr double kSideInner = 0.95;        // from this share of the rim's radius on.
constexpr double kMaxUprightCosine = 0.7;  // between the axis and the normal of a Gaussian of the side.
constexpr double kMaxStray = 0.2;          // of a part that turns: shadows, and ground beside it.
constexpr double kSideReach = 0.5;         // below the top, in radii of the rim.

double HeightOf(const TurntableAxis& axis, const Eigen::Vector3d& x) {
  return (x - axis.point).dot(axis.direction);
}

double RadiusOf(const TurntableAxis& axis, const Eigen::Vector3d& x) {
  return (x - axis.point - HeightOf(axis, x) * axis.direction).norm();
}

Eigen::Vector3d CentreOf(const Gaussians& gaussians, size_t i) {
  const float* x = gaussians.centre.data() + 3 * i;
  return {x[0], x[1], x[2]};
}

// 0 when nothing rotates.
double RotatingRadius(const TurntableAxis& axis, const Gaussians& gaussians) {
  std::vector<double> radii;
  for (size_t i = 0; i < gaussians.size(); ++i) {
    if (!IsForeground(gaussians.foreground_logit[i])) continue;
    const double radius = RadiusOf(axis, CentreOf(gaussians, i));
    if (std::isfinite(radius)) radii.push_back(radius);
  }
  return radii.empty() ? 0 : Quantile(std::move(radii), kRadiusQuantile);
}

// Of a Gaussian's normal.
double CosineToAxis(const TurntableAxis& axis, const Gaussians& gaussians, size_t i) {
  const float* q = gaussians.rotation.data() + 4 * i;
  const Eigen::Vector3d normal =
      Eigen::Quaterniond(q[0], q[1], q[2], q[3]).normalized() * Eigen::Vector3d::UnitZ();
  return std::abs(normal.dot(axis.direction));
}

// That it hides.
double AreaOf(const Gaussians& gaussians, size_t i) {
  return Sigmoid(gaussians.opacity_logit[i]) *
         std::exp(double{gaussians.log_scale[2 * i]} + gaussians.log_scale[2 * i + 1]);
}

// At which much of what lies below or in the rotating part is level.
std::vector<double> LevelHeights(const RotatingRegion& region, double radius, const Gaussians& gaussians) {
  const double bin = kBinHeight * radius;
  const double lowest = region.low - radius;
  const auto count = static_cast<int>(std::max(0.0, region.high - lowest) / bin) + 1;
  std::vector<double> areas(count + 2);  // an empty one at either end
  for (size_t i = 0; i < gaussians.size(); ++i) {
    if (Sigmoid(gaussians.opacity_logit[i]) < kMinOpacity) continue;
    if (!(CosineToAxis(region.axis, gaussians, i) > kMinLevelCosine)) continue;
    const Eigen::Vector3d x = CentreOf(gaussians, i);
    const double at = (HeightOf(region.axis, x) - lowest) / bin;
    if (!(at >= 0 && at < count) || !(RadiusOf(region.axis, x) < radius)) continue;
    areas[static_cast<size_t>(at) + 1] += AreaOf(gaussians, i);
  }
  const double largest = *std::max_element(areas.begin(), areas.end());
  std::vector<double> heights;
  for (int i = 1; i <= count; ++i) {
    const double area = areas[i];
    const bool is_peak = area > areas[i - 1] && area >= areas[i + 1];
    if (!is_peak || area < kMinPeakShare * largest) continue;
    const double aside = (areas[i + 1] - areas[i - 1]) / (areas[i - 1] + area + areas[i + 1]);
    heights.push_back(lowest + (i - 0.5 + aside) * bin);
  }
  return heights;
}

Eigen::Matrix3d DownAlong(const Eigen::Vector3d& axis) {
  Eigen::Vector3d::Index least = 0;
  axis.cwiseAbs().minCoeff(&least);
  Eigen::Matrix3d rotation;
  rotation.row(0) = axis.cross(Eigen::Vector3d::Unit(least)).normalized();
  rotation.row(2) = -axis;
  rotation.row(1) = rotation.row(2).cross(rotation.row(0));
  return rotation;
}

// What lies higher than the surface is cut away. \param reach  of the directions from the axis.
LevelSurface LookFromAbove(const TurntableAxis& axis, double height, double tolerance, double reach,
                           Backend* backend) {
  PinholeView view;
  view.width = view.height = 2 * kSteps + 2;
  view.cx = view.cy = view.width / 2.0;
  view.fx = view.fy = kDistance * kSteps;
  const Eigen::Matrix3d rotation = DownAlong(axis.direction);
  const double eye = height + kDistance * reach;
  view.cam_from_world = {Eigen::Quaterniond(rotation), -rotation * (axis.point + eye * axis.direction)};
  view.cam_from_object = view.cam_from_world;
  view.near_depth = kDistance * reach - kNear * tolerance;
  RenderRequest request;
  request.view = view;
  request.geometry = true;
  const RenderedView rendered = backend->Render(request);

  LevelSurface surface{kDirections, kSteps, reach / kSteps, height, tolerance, {}, {}};
  for (int d = 0; d < kDirections; ++d) {
    const double angle = 2 * kPi * d / kDirections;
    for (int s = 0; s < kSteps; ++s) {
      const auto column = static_cast<size_t>(view.cx + (s + 0.5) * std::cos(angle));
      const auto row = static_cast<size_t>(view.cy + (s + 0.5) * std::sin(angle));
      const size_t p = row * static_cast<size_t>(view.width) + column;
      const bool is_seen = rendered.alpha[p] > 0.5F && rendered.median_depth[p] > 0;
      surface.heights.push_back(is_seen ? static_cast<float>(eye - rendered.median_depth[p])
                                        : std::numeric_limits<float>::quiet_NaN());
      for (int c = 0; c < 3; ++c) surface.colors.push_back(rendered.color[3 * p + c]);
    }
  }
  return surface;
}

// Moves the surface's height to the middle of what lies near it within `radius`, and its tolerance to how far
// that spreads, if it spreads farther.
void Settle(double radius, LevelSurface* surface) {
  std::vector<float> heights;
  for (int d = 0; d < surface->num_directions; ++d) {
    for (int s = 0; s < surface->num_steps && (s + 0.5) * surface->step < radius; ++s) {
      const float height = surface->heights[static_cast<size_t>(d) * surface->num_steps + s];
      if (std::abs(height - surface->height) <= kNear * surface->tolerance) heights.push_back(height);
    }
  }
  if (heights.empty()) return;
  const double middle = Quantile(heights, 0.5);
  for (float& height : heights) height = std::abs(height - static_cast<float>(middle));
  const double spread = kDeviations * kSigmaOfMad * Quantile(std::move(heights), 0.5);
  surface->height = middle;
  surface->tolerance = std::clamp(spread, surface->tolerance, kNear * surface->tolerance);
}

// Directions from the axis, across it, in which some camera sees what looks outwards.
std::vector<Eigen::Vector3d> SeenDirections(const TrainingScene& scene) {
  const TurntableAxis& axis = scene.region->axis;
  const Eigen::Matrix3d down = DownAlong(axis.direction);
  std::vector<Eigen::Vector3d> seen;
  for (int d = 0; d < kDirections; ++d) {
    const double angle = 2 * kPi * d / kDirections;
    const Eigen::Vector3d outwards = std::cos(angle) * down.row(0) + std::sin(angle) * down.row(1);
    const bool faces_one =
        std::any_of(scene.photos.begin(), scene.photos.end(), [&](const ScenePhoto& photo) {
          Eigen::Vector3d to_camera = CameraCentre(photo.view.cam_from_world) - axis.point;
          to_camera -= to_camera.dot(axis.direction) * axis.direction;
          return outwards.dot(to_camera) > kMinFacing * to_camera.norm();
        });
    if (faces_one) seen.push_back(outwards);
  }
  return seen;
}

// The side of a table from its top downwards: radii in the place of heights, and below each other what lies
// beside each other from above. Each direction is looked at by itself, from outside and level with the top.
LevelSurface LookFromAside(const TrainingScene& scene, double top, double radius, double tolerance,
                           Backend* backend) {
  const TurntableAxis& axis = scene.region->axis;
  const double reach = kSideReach * radius;
  const double distance = kDistance * radius;
  PinholeView view;
  view.width = 3;
  view.height = kSteps;
  view.cx = 1.5;
  view.cy = 0;
  view.fx = view.fy = (distance - radius) * kSteps / reach;
  view.near_depth = distance - radius - kNear * tolerance;
  const std::vector<Eigen::Vector3d> directions = SeenDirections(scene);
  LevelSurface surface{
      static_cast<int>(directions.size()), kSteps, reach / kSteps, radius, tolerance, {}, {}};
  for (const Eigen::Vector3d& outwards : directions) {
    Eigen::Matrix3d rotation;
    rotation.row(1) = -axis.direction;
    rotation.row(2) = -outwards;
    rotation.row(0) = rotation.row(1).cross(rotation.row(2));
    const Eigen::Vector3d eye = axis.point + top * axis.direction + distance * outwards;
    view.cam_from_world = {Eigen::Quaterniond(rotation), -rotation * eye};
    view.cam_from_object = view.cam_from_world;
    RenderRequest request;
    request.view = view;
    request.geometry = true;
    const RenderedView rendered = backend->Render(request);
    for (int s = 0; s < kSteps; ++s) {
      const size_t p = static_cast<size_t>(s) * view.width + 1;
      const bool is_seen = rendered.alpha[p] > 0.5F && rendered.median_depth[p] > 0;
      surface.heights.push_back(is_seen ? static_cast<float>(distance - rendered.median_depth[p])
                                        : std::numeric_limits<float>::quiet_NaN());
      for (int c = 0; c < 3; ++c) surface.colors.push_back(rendered.color[3 * p + c]);
    }
  }
  return surface;
}

// Where a surface ends.
class SurfaceEdges {
 public:
  explicit SurfaceEdges(const LevelSurface& surface) : surface_(surface) {
    // Most of a surface is even: half of its changes are its own.
    std::vector<float> changes;
    for (int d = 0; d < surface.num_directions; ++d) {
      for (int s = kApart; s + kApart < surface.num_steps; ++s) {
        if (IsOn(d, s - kApart) && IsOn(d, s + kApart)) changes.push_back(Change(d, s - kApart, s + kApart));
      }
    }
    if (changes.empty()) return;
    edge_ = kDeviations * kSigmaOfMad * Quantile(std::move(changes), 0.5);
  }

  bool IsOn(int d, int s) const {
    return std::abs(surface_.heights[At(d, s)] - surface_.height) <= surface_.tolerance;
  }
  // Only for places that it reaches. \param s  from kApart to kApart before the last.
  bool EndsAt(int d, int s) const {
    return !IsOn(d, s + kApart) || Change(d, s - kApart, s + kApart) > edge_;
  }
  // Where about s it gives way to what lies beyond [steps].
  double Place(int d, int s) const {
    int t = s - kApart;
    while (t < s + kApart && IsOn(d, t) && Change(d, t, s - kApart) <= Change(d, t, s + kApart)) ++t;
    return t;
  }

 private:
  size_t At(int d, int s) const { return static_cast<size_t>(d) * surface_.num_steps + s; }
  float Change(int d, int s, int t) const {
    float change = 0;
    for (int c = 0; c < 3; ++c) {
      change =
          std::max(change, std::abs(surface_.colors[3 * At(d, s) + c] - surface_.colors[3 * At(d, t) + c]));
    }
    return change;
  }

  const LevelSurface& surface_;
  double edge_ = std::numeric_limits<double>::infinity();
};

// Of a ring: the directions in which the surface reaches it, and those of them in which it ends there.
struct Ring {
  int on = 0;
  int ends = 0;
};

Ring RingAt(const LevelSurface& surface, const SurfaceEdges& edges, int s) {
  Ring ring;
  for (int d = 0; d < surface.num_directions; ++d) {
    if (!edges.IsOn(d, s - kApart)) continue;
    ++ring.on;
    ring.ends += edges.EndsAt(d, s) ? 1 : 0;
  }
  return ring;
}

// How far from the first place the edges of a ring lie.
double EdgeAt(const LevelSurface& surface, const SurfaceEdges& edges, int s) {
  double sum = 0;
  int count = 0;
  for (int d = 0; d < surface.num_directions; ++d) {
    if (!edges.IsOn(d, s - kApart) || !edges.EndsAt(d, s)) continue;
    sum += edges.Place(d, s);
    ++count;
  }
  return sum / std::max(count, 1) * surface.step;
}

// What lies below the first ring that most directions do not have is no longer the side.
void CutAtGap(LevelSurface* side) {
  bool has_begun = false;
  bool has_ended = false;
  for (int s = 0; s < side->num_steps; ++s) {
    int on = 0;
    for (int d = 0; d < side->num_directions; ++d) {
      const float height = side->heights[static_cast<size_t>(d) * side->num_steps + s];
      on += std::abs(height - side->height) <= side->tolerance ? 1 : 0;
    }
    const bool is_there = 2 * on >= side->num_directions;
    has_ended = has_ended || (has_begun && !is_there);
    has_begun = has_begun || is_there;
    for (int d = 0; has_ended && d < side->num_directions; ++d) {
      side->heights[static_cast<size_t>(d) * side->num_steps + s] = std::numeric_limits<float>::quiet_NaN();
    }
  }
}

// By how much nearly all of a side that ends at `end` lies before where its rim is.
double BeforeTheRim(const LevelSurface& side, double end) {
  std::vector<float> offsets;
  for (int d = 0; d < side.num_directions; ++d) {
    for (int s = 0; s < side.num_steps && (s + 0.5) * side.step < end; ++s) {
      const double offset = side.heights[static_cast<size_t>(d) * side.num_steps + s] - side.height;
      if (std::abs(offset) <= side.tolerance) offsets.push_back(static_cast<float>(offset));
    }
  }
  return offsets.empty() ? 0 : std::max(0.0F, Quantile(std::move(offsets), kNearlyAll));
}

// The largest share that seems to stand still of what is level on the top and of what stands upright at the
// side: on the one the photos may tell the motion, and not on the other.
double StaticShare(const TableRim& rim, double top_low, const Gaussians& gaussians) {
  const TurntableAxis& axis = rim.region.axis;
  std::array<double, 2> all = {};
  std::array<double, 2> still = {};
  for (size_t i = 0; i < gaussians.size(); ++i) {
    if (Sigmoid(gaussians.opacity_logit[i]) < kMinOpacity) continue;
    const Eigen::Vector3d x = CentreOf(gaussians, i);
    const double height = HeightOf(axis, x);
    const double radius = RadiusOf(axis, x);
    if (!(height > rim.region.low && height < rim.region.high && radius < rim.region.radius)) continue;
    const double cosine = CosineToAxis(axis, gaussians, i);
    const bool is_top = height > top_low && cosine > kMinLevelCosine;
    const bool is_side = radius > kSideInner * rim.region.radius && cosine < kMaxUprightCosine;
    if (!is_top && !is_side) continue;
    const double area = AreaOf(gaussians, i);
    all[is_top ? 0 : 1] += area;
    if (!IsForeground(gaussians.foreground_logit[i])) still[is_top ? 0 : 1] += area;
  }
  double share = 0;
  for (size_t part = 0; part < all.size(); ++part) {
    if (all[part] > 0) share = std::max(share, still[part] / all[part]);
  }
  return share;
}

}  // namespace

bool TableRim::IsUndecided() const { return static_share > kMaxStray; }

std::optional<CircularEdge> FindCircularEdge(const LevelSurface& surface, double min_share) {
  const SurfaceEdges edges(surface);
  std::vector<Ring> rings;  // from kApart on.
  for (int s = kApart; s + kApart < surface.num_steps; ++s) rings.push_back(RingAt(surface, edges, s));
  Ring all;
  int seen = 0;
  int num_tried = 0;
  for (const Ring& ring : rings) {
    if (2 * ring.on < surface.num_directions) continue;
    all.on += ring.on;
    all.ends += ring.ends;
    seen = std::max(seen, ring.on);
    ++num_tried;
  }
  if (all.on == 0) return std::nullopt;
  const double chance = static_cast<double>(all.ends) / all.on;
  std::optional<CircularEdge> clearest;
  for (size_t i = 0; i < rings.size(); ++i) {
    const Ring& ring = rings[i];
    // Beyond a square's sides only its corners are left: what ends counts by all directions that there are.
    const double share = static_cast<double>(ring.ends) / seen;
    if (2 * ring.on < surface.num_directions || share < min_share) continue;
    const double false_alarms = num_tried * BinomialTail(ring.ends, seen, chance);
    if (false_alarms > (clearest ? clearest->false_alarms : kMaxFalseAlarms)) continue;
    clearest = {EdgeAt(surface, edges, static_cast<int>(i) + kApart), share, false_alarms};
  }
  return clearest;
}

std::optional<TableRim> FindTableRim(const TrainingScene& scene, Backend* backend) {
  if (!scene.region || scene.mode != TrainMode::kS2gs || IsOneStation(scene)) return std::nullopt;
  const TurntableAxis& axis = scene.region->axis;
  const Gaussians gaussians = backend->GetGaussians();
  const double radius = RotatingRadius(axis, gaussians);
  if (!(radius > 0)) return std::nullopt;
  const std::vector<double> heights = LevelHeights(*scene.region, radius, gaussians);
  std::optional<CircularEdge> best;
  LevelSurface top;
  for (const double height : heights) {
    LevelSurface surface = LookFromAbove(axis, height, kBinHeight * radius, kReach * radius, backend);
    Settle(radius, &surface);
    const std::optional<CircularEdge> far = FindCircularEdge(surface, kMinRimShare);
    if (!far) continue;
    // From near a square is no circle.
    surface = LookFromAbove(axis, surface.height, surface.tolerance, kNearReach * far->distance, backend);
    std::optional<CircularEdge> edge = FindCircularEdge(surface, kMinRimShare);
    if (!edge) continue;
    edge->false_alarms *= static_cast<double>(heights.size());
    if (edge->false_alarms > kMaxFalseAlarms || (best && edge->distance <= best->distance)) continue;
    best = edge;
    top = std::move(surface);
  }
  if (!best) return std::nullopt;
  TableRim rim;
  rim.share = best->share;
  rim.false_alarms = best->false_alarms;
  rim.region = {axis, best->distance, top.height - top.tolerance, top.height + top.tolerance};
  const double depth_tolerance = std::max(top.tolerance, kBinHeight * best->distance);
  LevelSurface side = LookFromAside(scene, top.height, best->distance, depth_tolerance, backend);
  CutAtGap(&side);
  const std::optional<CircularEdge> end =
      side.num_directions < kMinSideDirections ? std::nullopt : FindCircularEdge(side, kMinSideShare);
  if (end) {
    rim.region.low = std::min(rim.region.low, top.height - end->distance);
    rim.region.radius += BeforeTheRim(side, end->distance);
  }
  rim.static_share = StaticShare(rim, top.height - top.tolerance, gaussians);
  return rim;
}

}  // namespace s2gs
