#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "sfm_split/base/angles.h"
#include "sfm_split/scene/camera_model.h"
#include "tests/support/synthetic_turntable_parts.h"

namespace s2gs::synthetic {
namespace {

constexpr double kPlatterThickness = 0.018;
constexpr double kFloorBelowPlatter = 0.05;

Eigen::Matrix<uint8_t, 3, 1> RandomColor(RandomNumbers* random) {
  return {static_cast<uint8_t>(random->Index(256)), static_cast<uint8_t>(random->Index(256)),
          static_cast<uint8_t>(random->Index(256))};
}

/// A point of the object in the shape's own frame, uniform over the surface.
SyntheticPoint PointOnObject(const SyntheticTurntableOptions& options, const Shape& shape,
                             RandomNumbers* random) {
  SyntheticPoint point;
  point.body = SyntheticBody::kObject;
  point.color = RandomColor(random);
  if (options.object == SyntheticObject::kPlate) {
    const double half = options.object_radius;
    point.x = {random->Uniform(-half, half), 0, random->Uniform(-half, half)};
    point.normal = -Eigen::Vector3d::UnitY();
    point.two_sided = true;
    return point;
  }
  const double cos_patch = std::cos(options.object_patch_deg * kDegree);
  while (true) {
    const Eigen::Vector3d direction = random->Direction();
    const double trial = random->Uniform();
    if (-direction.y() < cos_patch) continue;
    // A patch of the unit sphere grows by r^2 / cos(normal, direction) on the surface; 4 is above what the
    // waves reach.
    const double relative_radius = BumpyRadius(shape, direction) / shape.size.x();
    point.normal = BumpyNormal(shape, direction);
    if (trial * 4 > relative_radius * relative_radius / point.normal.dot(direction)) continue;
    point.x = BumpyRadius(shape, direction) * direction;
    return point;
  }
}

int NumTwins(double share, int num_points) { return static_cast<int>(std::lround(share * num_points / 2)); }

void AddClutter(SyntheticTurntable* turntable, const Rigid3& world_from_room, double floor_z) {
  const SyntheticTurntableOptions& options = turntable->options;
  RandomNumbers random = RandomFor(options.seed, kShapes);
  const auto add = [&](double angle_deg, double gap, const Eigen::Vector3d& half) {
    const double radius = options.platter_radius + gap + half.head<2>().norm();
    Shape box;
    box.size = half;
    box.frame_from_shape.rotation = Eigen::AngleAxisd(random.Uniform(0, 1.5), Eigen::Vector3d::UnitZ());
    box.frame_from_shape.translation = {radius * std::cos(angle_deg * kDegree),
                                        radius * std::sin(angle_deg * kDegree), floor_z + half.z()};
    box.frame_from_shape = world_from_room * box.frame_from_shape;
    turntable->room.push_back(box);
  };
  // In front, just over the platter: hides the platter's edge and the object's foot from low stations.
  add(-75, 0.01, {0.02, 0.015, 0.5 * kFloorBelowPlatter + 0.012});
  for (int i = 0; i < 8; ++i) {
    add(-20 + 28 * i + random.Uniform(-8, 8), random.Uniform(0.02, 0.35),
        {random.Uniform(0.02, 0.06), random.Uniform(0.02, 0.06), random.Uniform(0.02, 0.12)});
  }
}

}  // namespace

Eigen::Vector3d TableMiddle(const SyntheticTurntable& turntable) {
  return {0, 0, turntable.object.frame_from_shape.translation.z()};
}

Rigid3 WorldFromRoom(const SyntheticTurntable& turntable) {
  const Eigen::Quaterniond rotation(
      Eigen::AngleAxisd(turntable.options.table_tilt_deg * kDegree, Eigen::Vector3d(0.8, 0.6, 0)));
  const Eigen::Vector3d middle = TableMiddle(turntable);
  return {rotation, middle - rotation * middle};
}

void AddShapes(SyntheticTurntable* turntable) {
  const SyntheticTurntableOptions& options = turntable->options;
  const double radius = options.object_radius;
  const bool plate = options.object == SyntheticObject::kPlate;

  Shape& object = turntable->object;
  object.kind = plate ? ShapeKind::kBox : ShapeKind::kBumpy;
  object.size = Eigen::Vector3d(radius, plate ? 0 : radius, radius);
  if (!plate) object.waves = RandomWaves(options.seed, options.symmetry_fold);

  RandomNumbers random = RandomFor(options.seed, kObjectPoints);
  const Eigen::AngleAxisd to_twin(360 * kDegree / options.symmetry_fold, Eigen::Vector3d::UnitZ());
  const int num_twins = NumTwins(options.repeated_share, options.num_object_points);
  std::vector<SyntheticPoint>& points = turntable->points;
  for (int i = 0; i < options.num_object_points - num_twins; ++i) {
    points.push_back(PointOnObject(options, object, &random));
  }
  for (int i = 0; i < num_twins; ++i) {
    SyntheticPoint twin = points[i];
    twin.x = to_twin * twin.x;
    twin.normal = to_twin * twin.normal;
    points[i].twin = static_cast<int>(points.size());
    points.push_back(twin);
  }
  double mean_z = 0;
  for (const SyntheticPoint& point : points) mean_z += point.x.z() / static_cast<double>(points.size());
  object.frame_from_shape.translation = {options.object_offset.x(), options.object_offset.y(), -mean_z};
  for (SyntheticPoint& point : points) point.x = object.frame_from_shape * point.x;

  // A bumpy object is sunk into the platter a little, so that it does not stand on one point.
  const double platter_z = -mean_z - (plate ? 1 : 0.85) * radius;
  Shape& platter = turntable->platter;
  platter.kind = ShapeKind::kCylinder;
  platter.size = {options.platter_radius, options.platter_radius, kPlatterThickness / 2};
  platter.frame_from_shape.translation = {0, 0, platter_z - kPlatterThickness / 2};

  const Rigid3 world_from_room = WorldFromRoom(*turntable);
  const double floor_z =
      platter_z - kFloorBelowPlatter - options.platter_radius * std::sin(options.table_tilt_deg * kDegree);
  // Every camera stands within 1.5 distances of the middle. The wall behind the object comes nearer when no
  // camera can be there.
  const double d = options.distance;
  const double back = (options.azimuth_spread_deg > 90 ? 2.2 : 1.1) * d;
  Shape walls;
  walls.size = {2 * d, (2.2 * d + back) / 2, 1.25 * d};
  walls.frame_from_shape = world_from_room;
  walls.frame_from_shape.translation =
      world_from_room * Eigen::Vector3d(0, (back - 2.2 * d) / 2, floor_z + 1.25 * d);
  turntable->room.push_back(walls);
  AddClutter(turntable, world_from_room, floor_z);
}

void AddSurroundingPoints(SyntheticTurntable* turntable) {
  const SyntheticTurntableOptions& options = turntable->options;
  std::vector<SyntheticPoint>& points = turntable->points;

  RandomNumbers platter_random = RandomFor(options.seed, kPlatterPoints);
  const Shape& platter = turntable->platter;
  for (int i = 0; i < options.num_platter_points; ++i) {
    const double radius = options.platter_radius * std::sqrt(platter_random.Uniform());
    const double phi = platter_random.Uniform(0, 360) * kDegree;
    SyntheticPoint point;
    point.body = SyntheticBody::kPlatter;
    point.x = platter.frame_from_shape *
              Eigen::Vector3d(radius * std::cos(phi), radius * std::sin(phi), platter.size.z());
    point.color = RandomColor(&platter_random);
    points.push_back(point);
  }

  // Background points are where rays through random pixels of random images end, so that every image sees
  // some and near things get as many as they fill the images.
  RandomNumbers random = RandomFor(options.seed, kBackground);
  const int num_twins = NumTwins(options.repeated_share, options.num_background_points);
  const int num_bases = options.num_background_points - num_twins;
  const Rigid3 world_from_room = WorldFromRoom(*turntable);
  const Eigen::Vector3d up = world_from_room.rotation * Eigen::Vector3d::UnitZ();
  std::vector<int> bases;
  std::vector<Eigen::Vector3d> along_wall;
  while (static_cast<int>(bases.size()) < num_bases) {
    const size_t image = random.Index(turntable->scene.views.size());
    const Camera& camera = turntable->CameraOf(static_cast<int>(image));
    const Eigen::Vector2d xy(random.Uniform(0, options.background_image_share * options.width),
                             random.Uniform(0, options.height));
    const std::optional<Eigen::Vector3d> ray_in_cam = UnprojectFromImage(camera, xy);
    if (!ray_in_cam) continue;
    const Rigid3 world_from_cam = turntable->scene.views[image].cam_from_world.Inverse();
    const Ray ray{world_from_cam.translation, world_from_cam.rotation * *ray_in_cam};
    std::optional<RayHit> nearest;
    size_t nearest_shape = 0;
    for (size_t i = 0; i < turntable->room.size(); ++i) {
      const std::optional<RayHit> hit = Intersect(turntable->room[i], ray);
      if (hit && (!nearest || hit->t < nearest->t)) nearest = hit, nearest_shape = i;
    }
    S2GS_INVARIANT(nearest.has_value());  // the walls are closed and the cameras inside
    const bool wall = nearest_shape == 0;
    // The first ones get a twin along their wall.
    if (!wall && static_cast<int>(bases.size()) < num_twins) continue;
    SyntheticPoint point;
    point.body = SyntheticBody::kStatic;
    point.x = ray.origin + nearest->t * ray.direction;
    point.normal = wall ? Eigen::Vector3d(-nearest->normal) : nearest->normal;
    point.color = RandomColor(&random);
    const bool horizontal = std::abs(point.normal.dot(up)) > 0.9;
    along_wall.push_back(world_from_room.rotation * Eigen::Vector3d::UnitX());
    if (!horizontal) along_wall.back() = up.cross(point.normal).normalized();
    bases.push_back(static_cast<int>(points.size()));
    points.push_back(point);
  }
  for (int i = 0; i < num_twins; ++i) {
    SyntheticPoint twin = points[bases[i]];
    twin.x += options.repeat_distance * along_wall[i];
    points[bases[i]].twin = static_cast<int>(points.size());
    points.push_back(twin);
  }
}

}  // namespace s2gs::synthetic
