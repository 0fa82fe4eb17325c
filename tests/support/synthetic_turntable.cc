#include "tests/support/synthetic_turntable.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdio>

#include "sfm_split/base/angles.h"
#include "tests/support/synthetic_turntable_parts.h"

namespace s2gs {
namespace {

Camera MakeCamera(const SyntheticTurntableOptions& options, int index) {
  const double focal = options.focal_widths * options.width * (1 + 0.01 * index);
  const double cx = options.width * (0.5 + options.principal_point_offset.x());
  const double cy = 0.5 * options.height + options.width * options.principal_point_offset.y();
  Camera camera;
  camera.camera_id = static_cast<uint32_t>(index + 1);
  camera.model = options.camera_model;
  camera.width = static_cast<uint64_t>(options.width);
  camera.height = static_cast<uint64_t>(options.height);
  const CameraModelInfo& info = InfoOf(options.camera_model);
  camera.params.assign(info.num_focal_params, focal);
  camera.params.push_back(cx);
  camera.params.push_back(cy);
  camera.params.insert(camera.params.end(), options.distortion.begin(), options.distortion.end());
  camera.params.resize(info.NumParams(), 0);
  return camera;
}

/// A camera that stands at `distance` from `target` (room frame), azimuth 0 on the -y side.
Rigid3 CamFromRoom(const Eigen::Vector3d& target, double distance, double elevation_deg, double azimuth_deg,
                   double roll_deg) {
  const double elevation = elevation_deg * kDegree;
  const double azimuth = azimuth_deg * kDegree;
  const Eigen::Vector3d outwards(std::cos(elevation) * std::sin(azimuth),
                                 -std::cos(elevation) * std::cos(azimuth), std::sin(elevation));
  const Eigen::Vector3d z = -outwards;
  const Eigen::Vector3d x = z.cross(Eigen::Vector3d::UnitZ()).normalized();
  Eigen::Matrix3d rotation;
  rotation.row(0) = x;
  rotation.row(1) = z.cross(x);
  rotation.row(2) = z;
  const Eigen::AngleAxisd roll(roll_deg * kDegree, Eigen::Vector3d::UnitZ());
  const Eigen::Quaterniond cam_from_room = (roll * Eigen::Quaterniond(rotation)).normalized();
  return {cam_from_room, -(cam_from_room * (target + distance * outwards))};
}

Rigid3 RandomPose(const SyntheticTurntable& turntable, double elevation_deg, RandomNumbers* random) {
  const SyntheticTurntableOptions& options = turntable.options;
  const Rigid3 world_from_room = synthetic::WorldFromRoom(turntable);
  // The middle of the table is where the room is turned about: the same point in both frames.
  const Eigen::Vector3d target = synthetic::TableMiddle(turntable) +
                                 Eigen::Vector3d(0, 0, options.look_at_height) +
                                 random->Uniform(0, options.look_at_jitter) * random->Direction();
  const double spread = options.distance_spread / 2;
  const double distance = options.distance * random->Uniform(1 - spread, 1 + spread);
  const double azimuth = random->Uniform(-0.5, 0.5) * options.azimuth_spread_deg;
  const double roll = random->Uniform(-1, 1) * options.roll_deg;
  return CamFromRoom(target, distance, elevation_deg, azimuth, roll) * world_from_room.Inverse();
}

Rigid3 Shake(const SyntheticTurntableOptions& options, RandomNumbers* random) {
  const Eigen::Vector3d turn(random->Normal(), random->Normal(), random->Normal());
  const Eigen::Vector3d shift(random->Normal(), random->Normal(), random->Normal());
  const double angle = options.shake_deg * kDegree * turn.norm();
  return {Eigen::Quaterniond(Eigen::AngleAxisd(angle, turn.normalized())), options.shake_distance * shift};
}

/// Where the object lies on the platter after it was turned upside down.
Rigid3 PlatterFromFlippedObject(const SyntheticTurntable& turntable) {
  const Eigen::Quaterniond upside_down(Eigen::AngleAxisd(180 * kDegree, Eigen::Vector3d::UnitX()));
  const Eigen::Vector3d middle = turntable.object.frame_from_shape.translation;
  const Eigen::Vector2d offset = turntable.options.flip_offset;
  return {upside_down, middle - upside_down * middle + Eigen::Vector3d(offset.x(), offset.y(), 0)};
}

}  // namespace

OptionCheck SyntheticTurntableOptions::Check() const {
  const auto fault = [](const char* field, double value, const char* bound) {
    return OptionFault{field, std::to_string(value), bound};
  };
  if (stations < 1 || stations > 99) return fault("stations", stations, "1 <= stations <= 99");
  if (!(min_elevation_deg >= 0 && min_elevation_deg <= max_elevation_deg)) {
    return fault("min_elevation_deg", min_elevation_deg, "0 <= min_elevation_deg <= max_elevation_deg");
  }
  if (!(max_elevation_deg <= 89))
    return fault("max_elevation_deg", max_elevation_deg, "max_elevation_deg <= 89");
  if (!(azimuth_spread_deg >= 0 && azimuth_spread_deg <= 360)) {
    return fault("azimuth_spread_deg", azimuth_spread_deg, "0 <= azimuth_spread_deg <= 360");
  }
  if (!(distance > 4 * object_radius)) return fault("distance", distance, "distance > 4 * object_radius");
  if (!(distance_spread >= 0 && distance_spread <= 0.9)) {
    return fault("distance_spread", distance_spread, "0 <= distance_spread <= 0.9");
  }
  if (!(look_at_jitter >= 0 && look_at_jitter <= 0.1 * distance)) {
    return fault("look_at_jitter", look_at_jitter, "0 <= look_at_jitter <= distance / 10");
  }
  if (!(shake_deg >= 0)) return fault("shake_deg", shake_deg, "shake_deg >= 0");
  if (!(shake_distance >= 0)) return fault("shake_distance", shake_distance, "shake_distance >= 0");
  if (steps < 1 || steps > 999) return fault("steps", steps, "1 <= steps <= 999");
  if (!(step_deg >= 0.01 && step_deg <= 120)) return fault("step_deg", step_deg, "0.01 <= step_deg <= 120");
  if (!(step_jitter >= 0 && step_jitter <= 1))
    return fault("step_jitter", step_jitter, "0 <= step_jitter <= 1");
  if (!(table_tilt_deg >= 0 && table_tilt_deg <= 45)) {
    return fault("table_tilt_deg", table_tilt_deg, "0 <= table_tilt_deg <= 45");
  }
  if (flip_from_station < 0) return fault("flip_from_station", flip_from_station, "flip_from_station >= 0");
  if (!(object_radius > 0)) return fault("object_radius", object_radius, "object_radius > 0");
  if (!(object_patch_deg >= 5 && object_patch_deg <= 180)) {
    return fault("object_patch_deg", object_patch_deg, "5 <= object_patch_deg <= 180");
  }
  if (num_object_points < 0) return fault("num_object_points", num_object_points, "num_object_points >= 0");
  if (num_platter_points < 0)
    return fault("num_platter_points", num_platter_points, "num_platter_points >= 0");
  if (!(platter_radius > 0 && platter_radius <= 0.4 * distance)) {
    return fault("platter_radius", platter_radius, "0 < platter_radius <= 0.4 * distance");
  }
  if (num_background_points < 0) {
    return fault("num_background_points", num_background_points, "num_background_points >= 0");
  }
  if (!(background_image_share > 0 && background_image_share <= 1)) {
    return fault("background_image_share", background_image_share, "0 < background_image_share <= 1");
  }
  if (!(rotating_share >= 0 && rotating_share <= 1)) {
    return fault("rotating_share", rotating_share, "0 <= rotating_share <= 1");
  }
  if (!(repeated_share >= 0 && repeated_share <= 1)) {
    return fault("repeated_share", repeated_share, "0 <= repeated_share <= 1");
  }
  if (symmetry_fold < 1 || symmetry_fold > 12)
    return fault("symmetry_fold", symmetry_fold, "1 <= symmetry_fold <= 12");
  if (object == SyntheticObject::kPlate && symmetry_fold > 2) {
    return fault("symmetry_fold", symmetry_fold, "symmetry_fold <= 2 for a plate");
  }
  if (width < 16) return fault("width", width, "width >= 16");
  if (height < 16) return fault("height", height, "height >= 16");
  if (!(focal_widths > 0)) return fault("focal_widths", focal_widths, "focal_widths > 0");
  const CameraModelInfo& info = InfoOf(camera_model);
  if (!info.has_projection)
    return fault("camera_model", static_cast<int>(camera_model), "a model that can be projected");
  if (!distortion.empty() && distortion.size() != info.num_extra_params) {
    return fault("distortion", static_cast<double>(distortion.size()),
                 "as many as the camera model has, or none");
  }
  if (!(pixel_noise >= 0)) return fault("pixel_noise", pixel_noise, "pixel_noise >= 0");
  if (!(dropout >= 0 && dropout < 1)) return fault("dropout", dropout, "0 <= dropout < 1");
  if (num_extra_keypoints < 0)
    return fault("num_extra_keypoints", num_extra_keypoints, "num_extra_keypoints >= 0");
  if (num_watermarks < 0) return fault("num_watermarks", num_watermarks, "num_watermarks >= 0");
  const int num_images = hand_held ? steps : stations * steps;
  for (const auto& [image1, image2] : pairs) {
    if (image1 < 0 || image1 >= num_images || image2 < 0 || image2 >= num_images || image1 == image2) {
      return fault("pairs", image1, "two different images");
    }
  }
  if (!(max_view_change_deg >= 0))
    return fault("max_view_change_deg", max_view_change_deg, "max_view_change_deg >= 0");
  if (!(match_recall > 0 && match_recall <= 1))
    return fault("match_recall", match_recall, "0 < match_recall <= 1");
  if (!(outlier_share >= 0 && outlier_share <= 1))
    return fault("outlier_share", outlier_share, "0 <= outlier_share <= 1");
  if (!(structured_share >= 0 && structured_share <= 1)) {
    return fault("structured_share", structured_share, "0 <= structured_share <= 1");
  }
  if (!(descriptor_noise >= 0)) return fault("descriptor_noise", descriptor_noise, "descriptor_noise >= 0");
  return std::nullopt;
}

const Camera& SyntheticTurntable::CameraOf(int image) const {
  return scene.cameras[scene.views[static_cast<size_t>(image)].camera_id - 1];
}

Rigid3 SyntheticTurntable::CamFromBody(int image, SyntheticBody body) const {
  const View& view = scene.views[static_cast<size_t>(image)];
  if (body == SyntheticBody::kObject) return view.CamFromObject();
  if (body == SyntheticBody::kPlatter) {
    return view.cam_from_world * images[static_cast<size_t>(image)].world_from_platter;
  }
  return view.cam_from_world;
}

void synthetic::AddViews(SyntheticTurntable* turntable) {
  const SyntheticTurntableOptions& options = turntable->options;
  TurntableScene& scene = turntable->scene;
  RandomNumbers poses = RandomFor(options.seed, kPoses);
  RandomNumbers shake = RandomFor(options.seed, kPoses, 1);
  RandomNumbers table = RandomFor(options.seed, kTable);

  const int stations = options.hand_held ? options.steps : options.stations;
  const int steps = options.hand_held ? 1 : options.steps;
  const int num_cameras = options.camera_per_station ? stations : 1;
  for (int i = 0; i < num_cameras; ++i) scene.cameras.push_back(MakeCamera(options, i));
  scene.num_stations = stations;
  scene.scale_observable = stations > 1;
  scene.units = LengthUnit::kMetre;

  const double lowest = options.min_elevation_deg;
  const double range = options.max_elevation_deg - lowest;
  for (int station = 0; station < stations; ++station) {
    const double elevation = options.hand_held ? lowest + range * poses.Uniform()
                             : stations == 1   ? lowest + range / 2
                                               : lowest + range * station / (stations - 1);
    const Rigid3 station_pose = RandomPose(*turntable, elevation, &poses);
    for (int step = 0; step < steps; ++step) {
      const int turn_index = options.hand_held ? station : step;
      const double irregular = options.step_jitter * table.Uniform(-0.5, 0.5);
      View view;
      char name[32];
      std::snprintf(name, sizeof(name), "s%02d_i%03d.png", station, step);
      view.name = name;
      view.camera_id = options.camera_per_station ? static_cast<uint32_t>(station + 1) : 1;
      view.station = station;
      if (options.turning) {
        const double start = options.hand_held ? 0 : station * options.station_start_deg;
        const bool reference = scene.views.empty();
        view.angle_deg = start + options.step_deg * (turn_index + (reference ? 0 : irregular));
      }
      view.cam_from_world = Shake(options, &shake) * station_pose;
      const Eigen::Quaterniond turn(Eigen::AngleAxisd(view.angle_deg * kDegree, Eigen::Vector3d::UnitZ()));
      SyntheticImage image;
      image.step = step;
      image.flipped = options.flip_from_station > 0 && station >= options.flip_from_station;
      image.world_from_platter = Rigid3{turn, Eigen::Vector3d::Zero()};
      view.world_from_object = image.world_from_platter;
      if (image.flipped) {
        view.world_from_object = image.world_from_platter * PlatterFromFlippedObject(*turntable);
      }
      if (scene.views.empty()) scene.reference = view.name;
      scene.views.push_back(view);
      turntable->images.push_back(image);
    }
  }
}

SyntheticTurntable MakeSyntheticTurntable(const SyntheticTurntableOptions& options) {
  S2GS_INVARIANT(!options.Check());
  SyntheticTurntable turntable;
  turntable.options = options;
  synthetic::AddShapes(&turntable);
  synthetic::AddViews(&turntable);
  synthetic::AddSurroundingPoints(&turntable);
  synthetic::AddKeypoints(&turntable);
  if (options.descriptors) synthetic::AddDescriptors(&turntable);
  synthetic::AddMatches(&turntable);
  return turntable;
}

}  // namespace s2gs
