#include "tests/s2gs/table/table_on_ground.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "s2gs/core/rng.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/reporter.h"
#include "tests/support/view_from_above.h"

namespace s2gs {
namespace {

constexpr double kFocal = 200;
constexpr double kDistance = 5;
constexpr double kGround = -0.2;
constexpr double kLeafHalfWidth = 0.25;

// A grey value of each tile of this size, from 20 to 220.
double TileAt(uint64_t seed, double size, double x, double y) {
  const auto i = static_cast<uint64_t>(std::floor(x / size) + 1000);
  const auto j = static_cast<uint64_t>(std::floor(y / size) + 1000);
  return 20 + 200 * static_cast<double>(UnitFloat(RandomBits(seed, i, j).words[0]));
}

// A table that has turned by `angle` above ground that stands still, with a tiled card on a twelfth of its
// top.
double GreyAlong(const Rigid3& object_from_cam, const Rigid3& world_from_cam, const Eigen::Vector3d& in_cam,
                 TopLook top) {
  const Eigen::Vector3d from = object_from_cam.translation;
  const Eigen::Vector3d ray = object_from_cam.rotation * in_cam;
  const auto at_height = [&](double height) -> Eigen::Vector3d {
    return from + (height - from.z()) / ray.z() * ray;
  };
  const Eigen::Vector3d on_top = at_height(kTableTop);
  const bool is_top = on_top.head<2>().norm() < kTableRadius;
  const double to_leaf = (kTableLeafAt - from.x()) / ray.x();
  const Eigen::Vector3d on_leaf = from + to_leaf * ray;
  const bool is_leaf = to_leaf > 0 && std::abs(on_leaf.y()) < kLeafHalfWidth && on_leaf.z() < 0 &&
                       on_leaf.z() > kGround + 0.02;
  const bool leaf_first = is_leaf && (!is_top || to_leaf < (on_top - from).norm() / ray.norm());
  if (leaf_first) return TileAt(3, 0.08, on_leaf.y(), on_leaf.z());
  if (is_top) {
    const bool is_card = std::abs(on_top.x()) < kCardHalfSide && std::abs(on_top.y()) < kCardHalfSide;
    if (is_card && top == TopLook::kGreyCard) return 90;
    return is_card || top == TopLook::kTiled ? TileAt(2, 0.06, on_top.x(), on_top.y()) : 150;
  }
  for (double z = kTableTop; z > kTableBottom; z -= 0.004) {
    if (at_height(z).head<2>().norm() < kTableRadius) return 90;
  }
  const Eigen::Vector3d in_world = world_from_cam.rotation * in_cam;
  const Eigen::Vector3d on_ground =
      world_from_cam.translation + (kGround - world_from_cam.translation.z()) / in_world.z() * in_world;
  return TileAt(1, 0.4, on_ground.x(), on_ground.y());
}

// \param turn  of the camera, about its own place.
ScenePhoto PhotoAt(double angle, TopLook top, const Eigen::Quaterniond& turn, uint64_t seed) {
  ScenePhoto photo;
  PinholeView& view = photo.view;
  view = ViewFromAbove(kTablePhotoWidth, kTablePhotoHeight, kFocal, 0.3, kDistance);
  view.cam_from_world = Rigid3{turn, Eigen::Vector3d::Zero()} * view.cam_from_world;
  const Rigid3 world_from_object{Eigen::Quaterniond(Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitZ())),
                                 Eigen::Vector3d::Zero()};
  view.cam_from_object = view.cam_from_world * world_from_object;
  const Rigid3 world_from_cam = view.cam_from_world.Inverse();
  const Rigid3 object_from_cam = view.cam_from_object.Inverse();
  photo.image = {kTablePhotoWidth, kTablePhotoHeight, 3, {}};
  for (int y = 0; y < kTablePhotoHeight; ++y) {
    for (int x = 0; x < kTablePhotoWidth; ++x) {
      const Eigen::Vector3d in_cam((x + 0.5 - view.cx) / view.fx, (y + 0.5 - view.cy) / view.fy, 1);
      const double noise = 4 * static_cast<double>(UnitFloat(RandomBits(seed, x, y).words[0])) - 2;
      const double grey = GreyAlong(object_from_cam, world_from_cam, in_cam, top) + noise;
      for (int c = 0; c < 3; ++c) photo.image.pixels.push_back(static_cast<uint8_t>(std::lround(grey)));
    }
  }
  return photo;
}

}  // namespace

TrainingScene TableOnGround(int num_photos, TopLook top, double shake) {
  TrainingScene scene;
  scene.mode = TrainMode::kS2gs;
  scene.axis = TurntableAxis();
  scene.region = RotatingRegion{TurntableAxis(), 2, -0.5, 1};
  for (int i = 0; i < num_photos; ++i) {
    const double about = UnitFloat(RandomBits(5, i, 0).words[0]);
    const double as_far = i == 0 ? 1 : UnitFloat(RandomBits(5, i, 1).words[0]);
    const Eigen::Vector3d axis(std::cos(2 * kPi * about), std::sin(2 * kPi * about), 0);
    const Eigen::Quaterniond turn(Eigen::AngleAxisd(shake * as_far, axis));
    scene.photos.push_back(PhotoAt(2 * kPi * i / num_photos, top, turn, 10 + i));
  }
  for (int i = 0; i <= 10; ++i) {
    const double height = kTableTop + 0.05 * i;
    scene.points.push_back({{0.3, 0.1 * (i % 3), height}, {0, 0, 0}, true});
  }
  return scene;
}

std::vector<StationPhotos> LoadStations(const TrainingScene& scene) {
  Reporter silent;
  return LoadStationPhotos(
      scene, [](const ScenePhoto& photo) { return photo.image; }, silent);
}

void ForTopPixels(const PinholeView& view, const Rigid3& frame_from_cam,
                  const std::function<void(int, int, const Eigen::Vector2d&)>& work) {
  const Eigen::Vector3d from = frame_from_cam.translation;
  for (int y = 0; y < view.height; ++y) {
    for (int x = 0; x < view.width; ++x) {
      const Eigen::Vector3d ray = frame_from_cam.rotation * Eigen::Vector3d((x + 0.5 - view.cx) / view.fx,
                                                                            (y + 0.5 - view.cy) / view.fy, 1);
      const Eigen::Vector3d on_top = from + (kTableTop - from.z()) / ray.z() * ray;
      if (on_top.head<2>().norm() < kTableRadius) work(x, y, on_top.head<2>());
    }
  }
}

Image8 ShadeTop(Image8 photo, const PinholeView& view,
                const std::function<bool(const Eigen::Vector2d&)>& is_shaded,
                const std::array<double, 3>& factors) {
  ForTopPixels(view, view.cam_from_world.Inverse(), [&](int x, int y, const Eigen::Vector2d& place) {
    if (!is_shaded(place)) return;
    for (int c = 0; c < 3; ++c) {
      uint8_t& value = photo.Pixel(x, y)[c];
      value = static_cast<uint8_t>(std::lround(value * factors[c]));
    }
  });
  return photo;
}

void SpeckleTop(bool is_turning, TrainingScene* scene) {
  for (size_t i = 0; i < scene->photos.size(); ++i) {
    ScenePhoto& photo = scene->photos[i];
    const auto speckle = [&](int x, int y, const Eigen::Vector2d& place) {
      if (!(place.norm() < 0.85)) return;
      const auto bits = RandomBits(is_turning ? 7 : 70 + i, static_cast<int>(std::floor(place.x() / 0.06)),
                                   static_cast<int>(std::floor(place.y() / 0.06)));
      if (bits.words[0] % 3 == 0)
        std::fill_n(photo.image.Pixel(x, y), 3, static_cast<uint8_t>(40 + bits.words[1] % 60));
    };
    ForTopPixels(photo.view, photo.view.cam_from_object.Inverse(), speckle);
  }
}

std::vector<std::vector<float>> NothingHides() {
  return std::vector<std::vector<float>>(kTablePhotos,
                                         std::vector<float>(kTablePhotoWidth * kTablePhotoHeight, 0));
}

std::vector<std::vector<float>> AllAt(float depth) {
  std::vector<std::vector<float>> depths = NothingHides();
  for (std::vector<float>& of_photo : depths) std::fill(of_photo.begin(), of_photo.end(), depth);
  return depths;
}

void AddGaussian(const Eigen::Vector3d& x, float logit, Placement* gaussians) {
  for (int k = 0; k < 3; ++k) gaussians->centre.push_back(static_cast<float>(x[k]));
  gaussians->foreground_logit.push_back(logit);
}

}  // namespace s2gs
