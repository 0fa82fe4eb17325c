#include "sfm_split/turntable/steady_cameras.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <functional>
#include <optional>
#include <utility>
#include <vector>

#include "sfm_split/base/infinity.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/scene/camera_model.h"

namespace s2gs {
namespace {

constexpr int kGridSide = 9;  // places across the picture at which two maps of it are compared
// To which the move of a picture is measured, by tiles of it that lie a third of a pixel off at most [px of a
// picture whose longer side is kMeasuredSidePx, to which larger photos are shrunk for it].
constexpr double kMeasuredPx = 0.5;
constexpr double kMeasuredSidePx = 480;

double MeasuredPx(const Camera& camera) {
  const auto side = static_cast<double>(std::max(camera.width, camera.height));
  return kMeasuredPx * std::max(1.0, side / kMeasuredSidePx);
}

// Places across a camera's picture.
std::vector<Eigen::Vector2d> Grid(const Camera& camera) {
  std::vector<Eigen::Vector2d> grid;
  for (int y = 0; y < kGridSide; ++y) {
    for (int x = 0; x < kGridSide; ++x) {
      grid.emplace_back((x + 0.5) / kGridSide * static_cast<double>(camera.width),
                        (y + 0.5) / kGridSide * static_cast<double>(camera.height));
    }
  }
  return grid;
}

// The rotation that takes the rays of pixels nearest to those of the pixels that a map takes them to.
Eigen::Quaterniond NearestTurn(
    const Camera& camera, const std::function<std::optional<Eigen::Vector2d>(const Eigen::Vector2d&)>& map) {
  Eigen::Matrix3d sum = Eigen::Matrix3d::Zero();
  int num = 0;
  for (const Eigen::Vector2d& xy : Grid(camera)) {
    const std::optional<Eigen::Vector2d> moved = map(xy);
    if (!moved) continue;
    const std::optional<Eigen::Vector3d> from = UnprojectFromImage(camera, xy);
    const std::optional<Eigen::Vector3d> to = UnprojectFromImage(camera, *moved);
    if (!from || !to) continue;
    sum += to->normalized() * from->normalized().transpose();
    ++num;
  }
  if (num < 3) return Eigen::Quaterniond::Identity();
  return Eigen::Quaterniond(ClosestRotation(sum)).normalized();
}

// Where the camera, turned by `turn`, shows what it showed at xy.
std::optional<Eigen::Vector2d> TurnedPixel(const Camera& camera, const Eigen::Quaterniond& turn,
                                           const Eigen::Vector2d& xy) {
  const std::optional<Eigen::Vector3d> ray = UnprojectFromImage(camera, xy);
  if (!ray) return std::nullopt;
  return ProjectToImage(camera, turn * *ray);
}

Rigid3 Turned(const Eigen::Quaterniond& turn, const Rigid3& cam_from_world) {
  return Rigid3{turn, Eigen::Vector3d::Zero()} * cam_from_world;
}

// The turn that moves the picture as `photo_from_first` does, nearly: photo_cam_from_first_cam.
Eigen::Quaterniond TurnOf(const Camera& camera, const Eigen::Matrix3d& photo_from_first) {
  return NearestTurn(camera, [&](const Eigen::Vector2d& xy) -> std::optional<Eigen::Vector2d> {
    const Eigen::Vector3d moved = photo_from_first * xy.homogeneous();
    if (moved.z() <= 0) return std::nullopt;
    return moved.hnormalized();
  });
}

// Root mean square by which the camera, turned, moves its picture otherwise than `photo_from_first` [px].
double MoveErrorPx(const Camera& camera, const Eigen::Quaterniond& turn,
                   const Eigen::Matrix3d& photo_from_first) {
  double squares = 0;
  for (const Eigen::Vector2d& xy : Grid(camera)) {
    const std::optional<Eigen::Vector2d> turned = TurnedPixel(camera, turn, xy);
    if (!turned) return kInfinity;
    squares += (*turned - (photo_from_first * xy.homogeneous()).hnormalized()).squaredNorm();
  }
  return std::sqrt(squares) / kGridSide;
}

}  // namespace

SteadyCameras::SteadyCameras(const ScanFeatures& features, const std::map<uint32_t, Camera>& cameras) {
  for (const ScanImage& image : features.images) {
    const auto known = cameras.find(image.camera_id);
    const auto stated = features.cameras.find(image.camera_id);
    if (known == cameras.end() && stated == features.cameras.end()) continue;
    Photo photo;
    photo.camera = known != cameras.end() ? known->second : stated->second;
    photo.has_moved =
        image.photo_from_first != Eigen::Matrix3d::Identity() && InfoOf(photo.camera.model).has_projection;
    if (photo.has_moved) {
      photo.turn = TurnOf(photo.camera, image.photo_from_first);
      // A model that is none has a lens that no turn moves the picture by as it was measured.
      if (known != cameras.end() && stated != features.cameras.end()) {
        const Eigen::Quaterniond by_stated = TurnOf(stated->second, image.photo_from_first);
        if (MoveErrorPx(photo.camera, photo.turn, image.photo_from_first) >
            MoveErrorPx(stated->second, by_stated, image.photo_from_first) + MeasuredPx(photo.camera)) {
          photo.camera = stated->second;
          photo.turn = by_stated;
        }
      }
    }
    any_moved_ = any_moved_ || photo.has_moved;
    photos_.emplace(image.name, std::move(photo));
  }
}

bool SteadyCameras::HasMoved(const std::string& name) const {
  const auto photo = photos_.find(name);
  return photo != photos_.end() && photo->second.has_moved;
}

std::optional<Eigen::Vector2d> SteadyCameras::PhotographedPixel(const std::string& name,
                                                                const Eigen::Vector2d& xy) const {
  if (!HasMoved(name)) return xy;
  const Photo& photo = photos_.at(name);
  return TurnedPixel(photo.camera, photo.turn, xy);
}

double SteadyCameras::LargestTurn() const {
  double largest = 0;
  for (const auto& [name, photo] : photos_) {
    largest = std::max(largest, AngleBetween(photo.turn, Eigen::Quaterniond::Identity()));
  }
  return largest;
}

Eigen::Vector2d SteadyCameras::SteadyPixel(const Photo& photo, const Eigen::Vector2d& xy) const {
  // Beyond the lens' own reach no ray is known; such a keypoint stays.
  return TurnedPixel(photo.camera, photo.turn.conjugate(), xy).value_or(xy);
}

ScanFeatures SteadyCameras::Steady(const ScanFeatures& features) const {
  ScanFeatures steady = features;
  for (ScanImage& image : steady.images) {
    const auto photo = photos_.find(image.name);
    if (photo == photos_.end() || !photo->second.has_moved) continue;
    image.photo_from_first.setIdentity();
    for (Eigen::Vector2f& xy : image.keypoints) {
      xy = SteadyPixel(photo->second, xy.cast<double>()).cast<float>();
    }
  }
  return steady;
}

ColmapModel SteadyCameras::Steady(const ColmapModel& model) const {
  ColmapModel steady = model;
  for (auto& [id, image] : steady.images) {
    const auto photo = photos_.find(image.name);
    if (photo == photos_.end() || !photo->second.has_moved) continue;
    const auto camera = steady.cameras.find(image.camera_id);
    const Eigen::Quaterniond turn =
        camera == steady.cameras.end() ? photo->second.turn : TurnBy(photo->second, camera->second);
    image.cam_from_world = Turned(turn.conjugate(), image.cam_from_world);
    for (ColmapPoint2D& point : image.points2D) point.xy = SteadyPixel(photo->second, point.xy);
  }
  return steady;
}

// The same move of the picture, as a turn of a camera with other intrinsics.
Eigen::Quaterniond SteadyCameras::TurnBy(const Photo& photo, const Camera& camera) const {
  return NearestTurn(camera,
                     [&](const Eigen::Vector2d& xy) { return TurnedPixel(photo.camera, photo.turn, xy); });
}

void SteadyCameras::Shake(AlignedScene* aligned) const {
  std::map<uint32_t, const Camera*> cameras;
  for (const Camera& camera : aligned->scene.cameras) cameras[camera.camera_id] = &camera;
  const auto turn_of = [&](const Photo& photo, uint32_t camera_id) {
    const auto camera = cameras.find(camera_id);
    return camera == cameras.end() ? photo.turn : TurnBy(photo, *camera->second);
  };
  for (View& view : aligned->scene.views) {
    if (HasMoved(view.name))
      view.cam_from_world = Turned(turn_of(photos_.at(view.name), view.camera_id), view.cam_from_world);
  }
  for (ColmapModel* model : {&aligned->object, &aligned->background}) {
    for (auto& [id, image] : model->images) {
      if (!HasMoved(image.name)) continue;
      const Photo& photo = photos_.at(image.name);
      image.cam_from_world = Turned(turn_of(photo, image.camera_id), image.cam_from_world);
      for (ColmapPoint2D& point : image.points2D)
        point.xy = TurnedPixel(photo.camera, photo.turn, point.xy).value_or(point.xy);
    }
  }
}

}  // namespace s2gs
