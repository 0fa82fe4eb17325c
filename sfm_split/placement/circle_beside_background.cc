#include "sfm_split/placement/circle_beside_background.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/scene/axis_turn.h"
#include "sfm_split/solvers/eigen_solvers.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;

// What the adjustment brings together again; a table that was moved between stations lies farther apart.
constexpr double kMaxTurn = 5 * kDegree;  // a judgement
constexpr double kMaxMisplaced = 0.1;     // of the camera's distance from where the axis is; a judgement

struct Station {
  Rigid3 cam_from_world;  // by the scene: but for a turn about z
  Rigid3 cam_from_background;
  double turn_rad = 0;  // about z, of the camera's place in the world against the scene's
};

// Of each station one photo's, which the others share.
std::map<int, Station> StationsOfBoth(const AlignedScene& aligned, const ColmapModel& background) {
  std::map<std::string, const View*> view_of_name;
  for (const View& view : aligned.scene.views) view_of_name[view.name] = &view;
  std::map<int, Station> stations;
  for (const auto& [id, image] : background.images) {
    const auto view = view_of_name.find(image.name);
    if (view == view_of_name.end()) continue;
    stations.try_emplace(view->second->station,
                         Station{view->second->cam_from_world, image.cam_from_world, 0});
  }
  return stations;
}

// The axis as each station sees it is one line of the background, and what the scene has for its origin one
// point of it:  C_b(s) + u R_cb(s)^T t_cw(s) = o,  linear in the background's unit u and in o.
bool SolveUnit(const std::map<int, Station>& stations, double* unit, Vector3d* origin) {
  const auto rows = static_cast<Eigen::Index>(3 * stations.size());
  MatrixXd system = MatrixXd::Zero(rows, 4);
  VectorXd right(rows);
  Eigen::Index row = 0;
  for (const auto& [number, station] : stations) {
    system.block<3, 3>(row, 1).setIdentity();
    system.block<3, 1>(row, 0) =
        -(station.cam_from_background.rotation.conjugate() * station.cam_from_world.translation);
    right.segment<3>(row) = CameraCentre(station.cam_from_background);
    row += 3;
  }
  const VectorXd solution = system.colPivHouseholderQr().solve(right);
  *unit = solution(0);
  *origin = solution.tail<3>();
  return solution.allFinite() && *unit > 0;
}

// World from background; turns the stations. Nothing agrees: false.
bool Solve(std::map<int, Station>* stations, Sim3* world_from_background) {
  double unit = 1;
  Vector3d origin = Vector3d::Zero();
  if (!SolveUnit(*stations, &unit, &origin)) return false;
  Vector3d up = Vector3d::Zero();
  const auto up_of = [](const Station& station) {
    return Vector3d(station.cam_from_background.rotation.conjugate() *
                    (station.cam_from_world.rotation * Vector3d::UnitZ()));
  };
  for (const auto& [number, station] : *stations) up += up_of(station);
  up.normalize();
  // The first station is where the scene has it, but for what tilts its axis onto the common one.
  const Station& first = stations->begin()->second;
  const Eigen::Quaterniond tilt = Eigen::Quaterniond::FromTwoVectors(up, up_of(first));
  const Eigen::Quaterniond world_from_first =
      first.cam_from_world.rotation.conjugate() * first.cam_from_background.rotation;
  world_from_background->rotation = (world_from_first * tilt).normalized();
  world_from_background->scale = 1 / unit;
  world_from_background->translation = -(world_from_background->rotation * origin) / unit;
  for (auto& [number, station] : *stations) {
    const Rigid3 moved = TransformPose(*world_from_background, station.cam_from_background);
    const Matrix3d turn = (station.cam_from_world.rotation.conjugate() * moved.rotation).toRotationMatrix();
    station.turn_rad = -AngleAbout(Vector3d::UnitZ(), turn);
    const Vector3d centre =
        RotationAbout<double>(Vector3d::UnitZ(), station.turn_rad) * CameraCentre(station.cam_from_world);
    const double tilted = std::acos(std::min(1.0, up.dot(up_of(station))));
    if (tilted > kMaxTurn || (CameraCentre(moved) - centre).norm() > kMaxMisplaced * centre.norm())
      return false;
  }
  return true;
}

}  // namespace

bool PutBackgroundBeside(const ColmapModel& background, AlignedScene* aligned) {
  std::map<int, Station> stations = StationsOfBoth(*aligned, background);
  if (stations.size() < 2) return true;
  Sim3 world_from_background;
  if (!Solve(&stations, &world_from_background)) return false;
  const TurntableAxis table{Vector3d::Zero(), Vector3d::UnitZ()};
  std::map<std::string, const View*> view_of_name;
  for (View& view : aligned->scene.views) {
    view_of_name[view.name] = &view;
    const auto station = stations.find(view.station);
    if (station == stations.end()) continue;
    TurnView(table, -station->second.turn_rad, &view);
  }
  aligned->aligned_from_background = world_from_background;
  aligned->background = background;
  TransformModel(world_from_background, &aligned->background);
  std::vector<std::string> gone;
  for (auto& [id, image] : aligned->background.images) {
    aligned->cam_from_background[image.name] = background.images.at(id).cam_from_world;
    const auto view = view_of_name.find(image.name);
    if (view == view_of_name.end()) {
      gone.push_back(image.name);
    } else {
      image.cam_from_world = view->second->cam_from_world;
    }
  }
  RemoveImages(gone, &aligned->background);
  return true;
}

}  // namespace s2gs
