#include "sfm_split/joint_system/joint_problem.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/scene/axis_turn.h"
#include "sfm_split/scene/projection_jacobians.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// What a photo shows of an object that lies elsewhere than its turn puts it: radians, and of its distance.
constexpr double kOffTurn = 1e-3;

JointBody GatherBody(const ColmapModel& model, const std::map<std::string, int>& image_of_name) {
  JointBody body;
  std::map<uint32_t, int> image_of_id;
  for (const auto& [id, image] : model.images) {
    const auto found = image_of_name.find(image.name);
    if (found != image_of_name.end()) image_of_id[id] = found->second;
  }
  for (const auto& [id, point] : model.points3D) {
    const int index = static_cast<int>(body.points.size());
    for (const ColmapTrackElement& element : point.track) {
      const auto image = image_of_id.find(element.image_id);
      if (image == image_of_id.end()) continue;
      const std::vector<ColmapPoint2D>& points2D = model.images.at(element.image_id).points2D;
      if (element.point2D_idx >= points2D.size()) continue;
      JointObservation observation;
      observation.image = image->second;
      observation.point = index;
      observation.xy = points2D[element.point2D_idx].xy;
      observation.point2D_idx = element.point2D_idx;
      body.observations.push_back(observation);
    }
    body.points.push_back(point.xyz);
    body.point_ids.push_back(id);
  }
  return body;
}

// A model's image where the problem has one; null where it has not.
std::vector<ColmapImage*> ImagesOf(const JointProblem& problem, ColmapModel* model) {
  std::map<std::string, ColmapImage*> image_of_name;
  for (auto& [id, image] : model->images) image_of_name[image.name] = &image;
  std::vector<ColmapImage*> images;
  images.reserve(problem.images.size());
  for (const JointImage& image : problem.images) {
    const auto found = image_of_name.find(image.name);
    images.push_back(found == image_of_name.end() ? nullptr : found->second);
  }
  return images;
}

// Points, tracks and reprojection errors back into a model whose poses are in place already.
void ScatterBody(const JointProblem& problem, const JointBody& body, ColmapModel* model) {
  const std::vector<ColmapImage*> images = ImagesOf(problem, model);
  std::vector<std::vector<const JointObservation*>> tracks(body.points.size());
  for (const JointObservation& observation : body.observations) {
    if (observation.active) {
      tracks[observation.point].push_back(&observation);
    } else {
      images[observation.image]->points2D[observation.point2D_idx].point3D_id = kInvalidPoint3DId;
    }
  }
  for (size_t p = 0; p < body.points.size(); ++p) {
    ColmapPoint3D& point = model->points3D.at(body.point_ids[p]);
    point.xyz = body.points[p];
    point.track.clear();
    double sum = 0;
    for (const JointObservation* observation : tracks[p]) {
      ColmapImage& image = *images[observation->image];
      const Camera& camera = model->cameras.at(image.camera_id);
      Eigen::Vector2d xy;
      if (tracks[p].size() >= 2) {
        point.track.push_back({image.image_id, observation->point2D_idx});
        if (ProjectWithJacobians(camera.model, camera.params.data(), image.cam_from_world * point.xyz, &xy,
                                 nullptr, nullptr)) {
          sum += (xy - observation->xy).norm();
        }
      } else {
        image.points2D[observation->point2D_idx].point3D_id = kInvalidPoint3DId;
      }
    }
    if (point.track.empty()) {
      model->points3D.erase(body.point_ids[p]);
    } else {
      point.error = sum / static_cast<double>(point.track.size());
    }
  }
}

// The axis of freely placed objects: that of the turntable closest to them.
void FitAxisToObjectPoses(TurntableScene* scene) {
  std::vector<TurntablePose> poses;
  for (const View& view : scene->views) {
    poses.push_back({view.name, view.station, view.CamFromObject(), view.cam_from_world});
  }
  TurntableOptions options;
  options.known_scale = 1;
  const TurntableSolution solution = SolveTurntable(poses, options);
  if (solution.motion != TurntableMotion::kRotates) return;
  scene->axis = {solution.groups[0].point_in_world, solution.groups[0].axis_in_world};
}

}  // namespace

Rigid3 JointProblem::WorldFromObject(int image) const {
  if (free_object) return images[image].world_from_object;
  const Matrix3d turn = RotationAbout<double>(AxisDirection(), images[image].angle_rad);
  return {Eigen::Quaterniond(turn), AxisPoint() - turn * AxisPoint()};
}

std::vector<Rigid3> JointProblem::WorldFromObjects() const {
  std::vector<Rigid3> poses;
  poses.reserve(images.size());
  for (size_t i = 0; i < images.size(); ++i) poses.push_back(WorldFromObject(static_cast<int>(i)));
  return poses;
}

bool AreOnePose(const Rigid3& a, const Rigid3& b) {
  return AngleBetween(a.rotation, b.rotation) < 1e-12 && (a.translation - b.translation).norm() < 1e-12;
}

JointProblem MakeJointProblem(const AlignedScene& aligned) {
  JointProblem problem;
  std::map<uint32_t, int> camera_of_id;
  for (const Camera& camera : aligned.scene.cameras) {
    camera_of_id[camera.camera_id] = static_cast<int>(problem.cameras.size());
    problem.cameras.push_back(camera);
  }
  const Vector3d& direction = aligned.scene.axis.direction;
  const Vector3d point =
      aligned.scene.axis.point - direction * (aligned.scene.axis.point.z() / direction.z());
  problem.axis << direction.x() / direction.z(), direction.y() / direction.z(), point.x(), point.y();

  std::map<int, std::vector<int>> poses_of_station;
  std::map<std::string, int> image_of_name;
  // Images of a station whose poses differ (hand-held) keep poses of their own.
  for (const View& view : aligned.scene.views) {
    JointImage image;
    image.name = view.name;
    image.camera = camera_of_id.at(view.camera_id);
    image.angle_rad = view.angle_deg * kPi / 180;
    image.world_from_object = view.world_from_object;
    std::vector<int>& poses = poses_of_station[view.station];
    const auto shared = std::find_if(poses.begin(), poses.end(), [&](int pose) {
      return AreOnePose(problem.cam_from_world[static_cast<size_t>(pose)], view.cam_from_world);
    });
    if (shared == poses.end()) {
      image.pose = static_cast<int>(problem.cam_from_world.size());
      poses.push_back(image.pose);
      problem.cam_from_world.push_back(view.cam_from_world);
    } else {
      image.pose = *shared;
    }
    if (view.name == aligned.scene.reference) problem.reference = static_cast<int>(problem.images.size());
    image_of_name[view.name] = static_cast<int>(problem.images.size());
    problem.images.push_back(image);
  }
  // More than one way of lying on the table: the axis and the angle do not tell where the object is.
  for (size_t i = 0; i < problem.images.size(); ++i) {
    const Rigid3 by_axis = problem.WorldFromObject(static_cast<int>(i));
    const Rigid3& given = problem.images[i].world_from_object;
    const double distance = CameraCentre(problem.cam_from_world[problem.images[i].pose]).norm();
    problem.free_object |= AngleBetween(by_axis.rotation, given.rotation) > kOffTurn ||
                           (by_axis.translation - given.translation).norm() > kOffTurn * distance;
  }
  problem.object = GatherBody(aligned.object, image_of_name);
  problem.background = GatherBody(aligned.background, image_of_name);
  // A static keypoint's error comes from what surrounds it, which is the same in all photos of a station.
  std::map<std::pair<int, int>, std::vector<JointObservation*>> repeated;
  for (JointObservation& observation : problem.background.observations) {
    const int station = aligned.scene.views[static_cast<size_t>(observation.image)].station;
    repeated[{observation.point, station}].push_back(&observation);
  }
  for (const auto& [place, observations] : repeated) {
    for (JointObservation* observation : observations) {
      observation->weight = 1 / static_cast<double>(observations.size());
    }
  }
  return problem;
}

void ApplyJointProblem(const JointProblem& problem, AlignedScene* aligned) {
  TurntableScene& scene = aligned->scene;
  S2GS_INVARIANT(scene.views.size() == problem.images.size());
  scene.cameras = problem.cameras;
  for (const Camera& camera : problem.cameras) {
    for (ColmapModel* model : {&aligned->object, &aligned->background}) {
      const auto found = model->cameras.find(camera.camera_id);
      if (found != model->cameras.end()) found->second = camera;
    }
  }
  for (size_t i = 0; i < problem.images.size(); ++i) {
    View& view = scene.views[i];
    view.cam_from_world = problem.cam_from_world[problem.images[i].pose];
    view.world_from_object = problem.WorldFromObject(static_cast<int>(i));
    view.angle_deg = WrapAngle(problem.images[i].angle_rad) * 180 / kPi;
  }
  scene.axis = {problem.AxisPoint(), problem.AxisDirection()};
  if (problem.free_object) {
    FitAxisToObjectPoses(&scene);
    for (View& view : scene.views) view.angle_deg = TableAngleDeg(scene.axis, view.world_from_object);
  }

  const auto set_poses = [&] {
    std::map<std::string, const View*> view_of_name;
    for (const View& view : scene.views) view_of_name[view.name] = &view;
    for (auto& [id, image] : aligned->object.images) {
      image.cam_from_world = view_of_name.at(image.name)->CamFromObject();
    }
    for (auto& [id, image] : aligned->background.images) {
      image.cam_from_world = view_of_name.at(image.name)->cam_from_world;
    }
  };
  set_poses();
  ScatterBody(problem, problem.object, &aligned->object);
  ScatterBody(problem, problem.background, &aligned->background);
  BringIntoConventions(aligned);
  set_poses();
}

}  // namespace s2gs
