#include "sfm_split/turntable/align_scene.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <set>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr size_t kMaxBases = 6;           // images of a station that are tried as its base
constexpr double kEnoughOfStation = 0.7;  // of its images on the turntable

// The pose that a station's images share: median rotation, median of each coordinate of the centre.
Rigid3 MedianPose(const std::vector<Rigid3>& poses) {
  std::vector<Eigen::Quaterniond> rotations;
  std::vector<double> coordinates[3];
  for (const Rigid3& pose : poses) {
    rotations.push_back(pose.rotation);
    const Vector3d centre = CameraCentre(pose);
    for (int k = 0; k < 3; ++k) coordinates[k].push_back(centre(k));
  }
  Rigid3 median;
  median.rotation = MedianRotation(rotations);
  const Vector3d centre(UpperMedian(coordinates[0]), UpperMedian(coordinates[1]),
                        UpperMedian(coordinates[2]));
  median.translation = -(median.rotation * centre);
  return median;
}

// c_from_a = c_from_b * b_from_a for similarities.
Sim3 Compose(const Sim3& c_from_b, const Sim3& b_from_a) {
  return {c_from_b.scale * b_from_a.scale, (c_from_b.rotation * b_from_a.rotation).normalized(),
          c_from_b * b_from_a.translation};
}

struct Stations {
  std::map<std::string, int> of_image;
  int count = 0;

  // Images without a station get one of their own; numbers are made dense in order of first names.
  Stations(const ColmapModel& object, const ColmapModel* background,
           const std::map<std::string, int>& given) {
    std::set<std::string> names;
    for (const ColmapModel* model : {&object, background}) {
      if (model == nullptr) continue;
      for (const auto& [id, image] : model->images) names.insert(image.name);
    }
    std::map<int, int> dense;
    for (const std::string& name : names) {
      const auto found = given.find(name);
      if (found == given.end()) {
        of_image[name] = count++;
      } else {
        const auto [entry, is_new] = dense.try_emplace(found->second, count);
        if (is_new) ++count;
        of_image[name] = entry->second;
      }
    }
  }
};

// Pairs the poses of both models by name; an image that the background lacks takes its station's pose.
// Without a background each station's pose is that of its `base`-th image, in order of names.
std::vector<TurntablePose> PairPoses(const ColmapModel& object, const ColmapModel* background,
                                     const Stations& stations, const std::vector<size_t>& base) {
  std::map<std::string, Rigid3> in_object;
  for (const auto& [id, image] : object.images) in_object[image.name] = image.cam_from_world;
  std::map<std::string, Rigid3> in_world;
  std::map<int, std::vector<Rigid3>> of_station;
  const bool has_background = background != nullptr && !background->images.empty();
  if (has_background) {
    for (const auto& [id, image] : background->images) {
      in_world[image.name] = image.cam_from_world;
      of_station[stations.of_image.at(image.name)].push_back(image.cam_from_world);
    }
  }
  std::map<int, Rigid3> station_pose;
  for (const auto& [station, poses] : of_station) station_pose[station] = MedianPose(poses);

  if (!has_background) {
    // The world is where the object lies at that image.
    std::map<int, std::vector<Rigid3>> in_order;
    for (const auto& [name, cam_from_object] : in_object) {
      in_order[stations.of_image.at(name)].push_back(cam_from_object);
    }
    for (const auto& [station, poses] : in_order) {
      station_pose[station] = poses[std::min(base[static_cast<size_t>(station)], poses.size() - 1)];
    }
  }

  std::vector<TurntablePose> pairs;
  for (const auto& [name, cam_from_object] : in_object) {
    TurntablePose pair;
    pair.name = name;
    pair.station = stations.of_image.at(name);
    pair.cam_from_object = cam_from_object;
    if (const auto own = in_world.find(name); own != in_world.end()) {
      pair.cam_from_world = own->second;
    } else if (const auto shared = station_pose.find(pair.station); shared != station_pose.end()) {
      pair.cam_from_world = shared->second;
    } else {
      continue;
    }
    pairs.push_back(pair);
  }
  return pairs;
}

// The share of each station's images that are on the turntable.
std::vector<double> InlierShares(const std::vector<TurntablePose>& poses, const TurntableSolution& solution,
                                 int num_stations) {
  std::vector<double> all(static_cast<size_t>(num_stations), 0);
  std::vector<double> shares(all.size(), 0);
  for (size_t t = 0; t < poses.size(); ++t) {
    const auto station = static_cast<size_t>(poses[t].station);
    all[station] += 1;
    shares[station] += solution.images[t].inlier ? 1 : 0;
  }
  for (size_t s = 0; s < all.size(); ++s) shares[s] = all[s] > 0 ? shares[s] / all[s] : 1;
  return shares;
}

// Where along the axis [from `origin`] the object's points lie in the mean, 5 % trimmed at both ends.
double MeanHeight(const ColmapModel& object, const Vector3d& origin, const Vector3d& axis) {
  std::vector<double> heights;
  for (const auto& [id, point] : object.points3D) {
    const double height = axis.dot(point.xyz - origin);
    if (std::isfinite(height)) heights.push_back(height);
  }
  if (heights.empty()) return 0;
  std::sort(heights.begin(), heights.end());
  const size_t trim = heights.size() / 20;
  double sum = 0;
  for (size_t i = trim; i < heights.size() - trim; ++i) sum += heights[i];
  return sum / static_cast<double>(heights.size() - 2 * trim);
}

// Rotation that takes the axis to z and the horizontal part of `towards` to x.
Matrix3d UprightFromWorld(const Vector3d& axis, const Vector3d& towards) {
  Vector3d x = towards - axis * axis.dot(towards);
  if (x.norm() <= 1e-6 * towards.norm()) x = axis.unitOrthogonal();
  x.normalize();
  Matrix3d rows;
  rows << x.transpose(), axis.cross(x).transpose(), axis.transpose();
  return rows;
}

}  // namespace

Rigid3 TransformPose(const Sim3& new_from_old, const Rigid3& cam_from_old) {
  const Eigen::Quaterniond rotation =
      (cam_from_old.rotation * new_from_old.rotation.conjugate()).normalized();
  return {rotation, -(rotation * (new_from_old * CameraCentre(cam_from_old)))};
}

void BringIntoConventions(AlignedScene* aligned) {
  TurntableScene& scene = aligned->scene;
  if (scene.views.empty()) return;
  const Vector3d& axis = scene.axis.direction;
  const Vector3d origin = scene.axis.point + MeanHeight(aligned->object, scene.axis.point, axis) * axis;
  Sim3 new_from_old;
  new_from_old.rotation =
      Eigen::Quaterniond(UprightFromWorld(axis, CameraCentre(scene.Reference()->cam_from_world) - origin))
          .normalized();
  new_from_old.translation = -(new_from_old.rotation * origin);
  const Rigid3 moved{new_from_old.rotation, new_from_old.translation};
  const Rigid3 back = moved.Inverse();
  for (View& view : scene.views) {
    view.cam_from_world = TransformPose(new_from_old, view.cam_from_world);
    view.world_from_object = moved * view.world_from_object * back;
  }
  TransformModel(new_from_old, &aligned->object);
  TransformModel(new_from_old, &aligned->background);
  aligned->aligned_from_object = Compose(new_from_old, aligned->aligned_from_object);
  aligned->aligned_from_background = Compose(new_from_old, aligned->aligned_from_background);
  scene.axis = TurntableAxis();
}

void TransformModel(const Sim3& new_from_old, ColmapModel* model) {
  for (auto& [id, image] : model->images) {
    image.cam_from_world = TransformPose(new_from_old, image.cam_from_world);
  }
  for (auto& [id, point] : model->points3D) point.xyz = new_from_old * point.xyz;
}

void RemoveImages(const std::vector<std::string>& names, ColmapModel* model) {
  const std::set<std::string> gone_names(names.begin(), names.end());
  std::set<uint32_t> gone;
  for (auto image = model->images.begin(); image != model->images.end();) {
    if (gone_names.count(image->second.name) > 0) {
      gone.insert(image->first);
      image = model->images.erase(image);
    } else {
      ++image;
    }
  }
  if (gone.empty()) return;
  for (auto point = model->points3D.begin(); point != model->points3D.end();) {
    std::vector<ColmapTrackElement>& track = point->second.track;
    track.erase(std::remove_if(track.begin(), track.end(),
                               [&](const ColmapTrackElement& e) { return gone.count(e.image_id) > 0; }),
                track.end());
    if (track.size() >= 2) {
      ++point;
      continue;
    }
    for (const ColmapTrackElement& element : track) {
      const auto image = model->images.find(element.image_id);
      if (image != model->images.end() && element.point2D_idx < image->second.points2D.size()) {
        image->second.points2D[element.point2D_idx].point3D_id = kInvalidPoint3DId;
      }
    }
    point = model->points3D.erase(point);
  }
}

namespace {

// Without a background: which image each station is based on. One whose images contradict the one that it was
// based on gets another. \param poses, solution  with the first image of each.
std::vector<size_t> BasesOfStations(const ColmapModel& object, const ColmapModel* background,
                                    const Stations& stations, const TurntableOptions& solver,
                                    const std::vector<TurntablePose>& poses,
                                    const TurntableSolution& solution) {
  std::vector<size_t> base(static_cast<size_t>(stations.count), 0);
  std::vector<double> best = InlierShares(poses, solution, stations.count);
  for (size_t attempt = 1; attempt <= kMaxBases; ++attempt) {
    std::vector<size_t> tried = base;
    bool any = false;
    for (size_t s = 0; s < tried.size(); ++s) {
      if (best[s] >= kEnoughOfStation) continue;
      tried[s] = attempt;
      any = true;
    }
    if (!any) break;
    const std::vector<TurntablePose> tried_poses = PairPoses(object, background, stations, tried);
    const TurntableSolution found = SolveTurntable(tried_poses, solver);
    if (found.motion != TurntableMotion::kRotates) continue;
    const std::vector<double> shares = InlierShares(tried_poses, found, stations.count);
    for (size_t s = 0; s < tried.size(); ++s) {
      if (shares[s] <= best[s] || tried[s] != attempt) continue;
      best[s] = shares[s];
      base[s] = attempt;
    }
  }
  return base;
}

// The frame of an aligned scene: origin where the axis meets the object's region, z along it.
void FindAlignedFrame(const ColmapModel& object, AlignedScene* scene) {
  const TurntableSolution& solution = scene->solution;
  const TurntableGroup& group = solution.groups[0];
  const Vector3d& n = group.axis_in_world;
  const double scale = solution.scale;
  // p and a lie on the axis at the same height: an axial step in the object is one in the world.
  const double height = MeanHeight(object, group.point_in_object, group.axis_in_object);
  const Vector3d origin = group.point_in_world + scale * height * n;
  const Vector3d reference_camera = CameraCentre(scene->poses[solution.reference].cam_from_world);
  Sim3& aligned_from_background = scene->aligned_from_background;
  aligned_from_background.scale = 1 / scale;
  aligned_from_background.rotation =
      Eigen::Quaterniond(UprightFromWorld(n, reference_camera - origin)).normalized();
  aligned_from_background.translation = -(aligned_from_background.rotation * origin) / scale;
  scene->aligned_from_object = Compose(aligned_from_background, WorldFromObjectAtAngle(solution, 0, 0));
}

// The poses of each station's photos in the aligned frame.
std::map<int, std::vector<Rigid3>> PosesOfStations(const AlignedScene& aligned, bool has_background,
                                                   int num_stations) {
  const TurntableSolution& solution = aligned.solution;
  std::map<int, std::vector<Rigid3>> poses_of_station;
  for (size_t t = 0; t < aligned.poses.size(); ++t) {
    if (!solution.images[t].inlier) continue;
    const TurntablePose& pose = aligned.poses[t];
    Rigid3 cam_from_aligned = TransformPose(aligned.aligned_from_background, pose.cam_from_world);
    if (!has_background && num_stations > 1 && solution.images[t].group == 0) {
      // Each image's own: the object's pose there, turned back.
      const Eigen::Quaterniond back(Eigen::AngleAxisd(-solution.images[t].angle_rad, Vector3d::UnitZ()));
      cam_from_aligned =
          TransformPose(aligned.aligned_from_object, pose.cam_from_object) * Rigid3{back, Vector3d::Zero()};
    }
    poses_of_station[pose.station].push_back(cam_from_aligned);
  }
  return poses_of_station;
}

// The scene's views by name, its cameras, and what is known of it.
void MakeViews(const ColmapModel& object, bool has_background, int num_stations, CameraPoseSource pose_source,
               AlignedScene* aligned) {
  const TurntableSolution& solution = aligned->solution;
  std::map<std::string, uint32_t> camera_of_image;
  for (const auto& [id, image] : object.images) camera_of_image[image.name] = image.camera_id;
  std::map<int, Rigid3> station_pose;
  std::map<int, int> station_number;
  for (const auto& [station, poses] : PosesOfStations(*aligned, has_background, num_stations)) {
    station_pose[station] = MedianPose(poses);
    station_number.emplace(station, static_cast<int>(station_number.size()));
  }
  const Sim3 object_from_aligned = aligned->aligned_from_object.Inverse();
  for (size_t t = 0; t < aligned->poses.size(); ++t) {
    const TurntablePose& pose = aligned->poses[t];
    const TurntableImageFit& fit = solution.images[t];
    if (!fit.inlier) continue;
    View view;
    view.name = pose.name;
    view.camera_id = camera_of_image.at(pose.name);
    view.station = station_number.at(pose.station);
    view.angle_deg = fit.angle_rad * 180 / kPi;
    view.cam_from_world = pose_source == CameraPoseSource::kSharedStations
                              ? station_pose.at(pose.station)
                              : TransformPose(aligned->aligned_from_background, pose.cam_from_world);
    if (fit.group == 0) {
      view.world_from_object.rotation =
          Eigen::Quaterniond(Eigen::AngleAxisd(fit.angle_rad, Vector3d::UnitZ()));
    } else {
      const Sim3 moved = Compose(Compose(aligned->aligned_from_background,
                                         WorldFromObjectAtAngle(solution, fit.group, fit.angle_rad)),
                                 object_from_aligned);
      view.world_from_object = {moved.rotation, moved.translation};
    }
    aligned->scene.views.push_back(view);
  }
  std::sort(aligned->scene.views.begin(), aligned->scene.views.end(),
            [](const View& a, const View& b) { return a.name < b.name; });
  aligned->scene.reference = aligned->poses[solution.reference].name;
  for (const auto& [id, camera] : object.cameras) aligned->scene.cameras.push_back(camera);
  aligned->scene.num_stations = static_cast<int>(station_number.size());
  aligned->scene.scale_observable = solution.scale_observable;
}

// Leaves images without a view out of both models, and gives the others their view's pose.
void PoseModels(AlignedScene* aligned) {
  std::map<std::string, const View*> view_of_image;
  for (const View& view : aligned->scene.views) view_of_image[view.name] = &view;
  std::set<std::string> left_out;
  for (const ColmapModel* model : {&aligned->object, &aligned->background}) {
    for (const auto& [id, image] : model->images) {
      if (view_of_image.count(image.name) == 0) left_out.insert(image.name);
    }
  }
  aligned->left_out.assign(left_out.begin(), left_out.end());
  RemoveImages(aligned->left_out, &aligned->object);
  RemoveImages(aligned->left_out, &aligned->background);
  for (auto& [id, image] : aligned->object.images)
    image.cam_from_world = view_of_image.at(image.name)->CamFromObject();
  for (auto& [id, image] : aligned->background.images) {
    image.cam_from_world = view_of_image.at(image.name)->cam_from_world;
  }
}

}  // namespace

AlignedScene AlignScene(const ColmapModel& object, const ColmapModel* background,
                        const std::map<std::string, int>& station_of_image, const AlignOptions& options) {
  AlignedScene aligned;
  const bool has_background = background != nullptr && !background->images.empty();
  const Stations stations(object, background, station_of_image);
  std::vector<size_t> base(static_cast<size_t>(stations.count), 0);
  aligned.poses = PairPoses(object, background, stations, base);
  TurntableOptions solver = options.turntable;
  if (!has_background) solver.known_scale = 1;
  aligned.solution = SolveTurntable(aligned.poses, solver);
  if (!has_background && stations.count > 1) {
    base = BasesOfStations(object, background, stations, solver, aligned.poses, aligned.solution);
    aligned.poses = PairPoses(object, background, stations, base);
    aligned.solution = SolveTurntable(aligned.poses, solver);
  }
  TurntableSolution& solution = aligned.solution;
  if (!has_background) {
    solution.scale_observable = false;
    solution.scale_sigma_rel = std::numeric_limits<double>::infinity();
  }
  if (solution.motion != TurntableMotion::kRotates) return aligned;

  FindAlignedFrame(object, &aligned);
  aligned.object = object;
  TransformModel(aligned.aligned_from_object, &aligned.object);
  if (has_background) {
    aligned.background = *background;
    TransformModel(aligned.aligned_from_background, &aligned.background);
    for (const auto& [id, image] : background->images) {
      aligned.cam_from_background[image.name] = image.cam_from_world;
    }
  }

  MakeViews(object, has_background, stations.count, options.pose_source, &aligned);
  PoseModels(&aligned);
  return aligned;
}

}  // namespace s2gs
