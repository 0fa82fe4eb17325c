#include "sfm_split/sweep/swept_points.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/scene/axis_turn.h"
#include "tests/support/camera_towards_origin.h"
#include "tests/support/option_bounds.h"
#include "tests/support/random_numbers.h"
#include "tests/support/still_squares.h"

namespace s2gs {
namespace {

using Eigen::Vector3d;

constexpr int kWidth = 240;
constexpr int kHeight = 180;
constexpr double kFocal = 500;
constexpr int kPhotos = 24;
constexpr double kNoise = 2;  // grey values

// What keypoints find nothing on: three balls whose shade varies by some values over a dozen pixels.
struct Ball {
  Vector3d centre;
  double radius;
};
const std::vector<Ball> kThing = {{{0.1, 0, 0}, 0.45}, {{0.1, 0.1, 0.55}, 0.25}, {{-0.3, -0.35, -0.1}, 0.25}};

double Shade(const Vector3d& x) {
  return 120 + 14 * std::sin(43 * x.x() + 3 * std::sin(9 * x.z())) + 14 * std::sin(41 * x.y() + 5 * x.x()) +
         14 * std::sin(45 * x.z() + 2 * std::sin(8 * x.y()));
}

// Where a ray meets the thing first.
std::optional<Vector3d> Hit(const Vector3d& origin, const Vector3d& direction) {
  double nearest = 1e9;
  for (const Ball& ball : kThing) {
    const Vector3d from = origin - ball.centre;
    const double b = from.dot(direction);
    const double inside = b * b - from.squaredNorm() + ball.radius * ball.radius;
    if (inside > 0) nearest = std::min(nearest, -b - std::sqrt(inside));
  }
  if (nearest > 1e8) return std::nullopt;
  return origin + nearest * direction;
}

class SurfaceSweepTest : public testing::Test {
 protected:
  SurfaceSweepTest() {
    Camera camera;
    camera.camera_id = 1;
    camera.model = CameraModelId::kSimplePinhole;
    camera.width = kWidth;
    camera.height = kHeight;
    camera.params = {kFocal, kWidth / 2.0, kHeight / 2.0};
    scan_.scene.cameras = {camera};
    scan_.scene.num_stations = 1;
    scan_.object.cameras[1] = camera;
    for (int k = 0; k < kPhotos; ++k) {
      View view;
      view.name = "p" + std::to_string(10 + k);
      view.camera_id = 1;
      view.angle_deg = 360.0 * k / kPhotos;
      view.cam_from_world = CameraTowardsOrigin({4, 0.5, 1.2});
      view.world_from_object = TurnAbout(scan_.scene.axis, view.angle_deg * kDegree);
      scan_.scene.views.push_back(view);
      ColmapImage image;
      image.image_id = static_cast<uint32_t>(k + 1);
      image.camera_id = 1;
      image.name = view.name;
      image.cam_from_world = view.CamFromObject();
      scan_.object.images[image.image_id] = image;
      true_pose_[view.name] = view.CamFromObject();
    }
    scan_.scene.reference = "p10";
  }

  // \param factor  photos are as many times larger, shown by the same lens.
  GreyPhoto Photo(const std::string& name, bool turns, int factor = 1) const {
    const Rigid3& pose = true_pose_.at(turns ? name : "p10");
    const Vector3d origin = CameraCentre(pose);
    RandomNumbers noise(7, static_cast<uint64_t>(std::stoi(name.substr(1))));
    GreyPhoto photo{factor * kWidth, factor * kHeight, {}};
    for (int y = 0; y < photo.height; ++y) {
      for (int x = 0; x < photo.width; ++x) {
        const Vector3d ray((x + 0.5) / factor - kWidth / 2.0, (y + 0.5) / factor - kHeight / 2.0, kFocal);
        const auto hit = Hit(origin, (pose.rotation.inverse() * ray).normalized());
        const double shade =
            (hit ? Shade(*hit) : StillSquares(x / factor, y / factor)) + kNoise * noise.Normal();
        photo.grey.push_back(static_cast<uint8_t>(std::clamp(std::round(shade), 0.0, 255.0)));
      }
    }
    return photo;
  }

  // How far places lie from where the truth puts the point of the surface that their first one shows [px].
  std::vector<double> ErrorsOf(const std::vector<AlignedTrack>& tracks, double factor) const {
    std::vector<double> errors;
    for (const AlignedTrack& track : tracks) {
      const auto pose_of = [&](const TrackPlace& place) {
        return true_pose_.at(scan_.object.images.at(place.image_id).name);
      };
      const Eigen::Vector2d first = track.places.front().place.xy / factor;
      const Rigid3 pose = pose_of(track.places.front());
      const Vector3d ray(first.x() - kWidth / 2.0, first.y() - kHeight / 2.0, kFocal);
      const auto hit = Hit(CameraCentre(pose), (pose.rotation.inverse() * ray).normalized());
      for (size_t k = 1; k < track.places.size(); ++k) {
        if (!hit) {
          errors.push_back(99);
          continue;
        }
        const Vector3d x = pose_of(track.places[k]) * *hit;
        const Eigen::Vector2d xy(kFocal * x.x() / x.z() + kWidth / 2.0,
                                 kFocal * x.y() / x.z() + kHeight / 2.0);
        errors.push_back((xy - track.places[k].place.xy / factor).norm());
      }
    }
    return errors;
  }

  AlignedScene scan_;
  std::map<std::string, Rigid3> true_pose_;
  Reporter silent_;
};

TEST_F(SurfaceSweepTest, FindsWhereNeighboursShowAPlaceOfASmoothSurface) {
  // Ids of points that the model has are not given again.
  scan_.object.points3D[41].point3D_id = 41;
  const SurfaceSweep sweep(
      scan_, [&](const std::string& name) { return Photo(name, true); }, {}, silent_);
  const std::vector<AlignedTrack> tracks = sweep.Tracks(PhotosLookedIn::kTracks, silent_);
  EXPECT_GT(tracks.size(), 100U);
  for (const AlignedTrack& track : tracks) {
    EXPECT_GT(track.point3D_id, 41U);
    EXPECT_EQ(track.places.size(), 3U);
    for (const TrackPlace& place : track.places) {
      EXPECT_EQ(place.point2D_idx, kNoKeypoint);
      EXPECT_FALSE(place.is_beside);
    }
  }
  const std::vector<double> errors = ErrorsOf(tracks, 1);
  EXPECT_LT(Quantile(errors, 0.5), 0.5);   // .36, of places on a ball of 55 px
  EXPECT_LT(Quantile(errors, 0.95), 1.5);  // 1.18
  // All photos that they face see more of them.
  const std::vector<AlignedTrack> facing = sweep.Tracks(PhotosLookedIn::kFacing, silent_);
  size_t num = 0;
  for (const AlignedTrack& track : facing) num += track.places.size();
  EXPECT_GT(num, 4 * facing.size());
}

TEST_F(SurfaceSweepTest, FindsItByPosesThatAreSomePixelsOff) {
  for (auto& [id, image] : scan_.object.images) {
    const Eigen::AngleAxisd lean(0.3 * kDegree, Vector3d::UnitZ());
    image.cam_from_world.rotation = Eigen::Quaterniond(lean) * image.cam_from_world.rotation;
    image.cam_from_world =
        image.cam_from_world * TurnAbout(scan_.scene.axis, 0.4 * kDegree * (id % 2 == 0 ? 1 : -1));
  }
  const SurfaceSweep sweep(
      scan_, [&](const std::string& name) { return Photo(name, true); }, {}, silent_);
  const std::vector<AlignedTrack> tracks = sweep.Tracks(PhotosLookedIn::kTracks, silent_);
  EXPECT_GT(tracks.size(), 100U);
  EXPECT_LT(Quantile(ErrorsOf(tracks, 1), 0.5), 0.5);  // .36, as by the right poses
}

// Twice as large, they are shrunk to the size that patches are made for; places are in the photos' pixels.
TEST_F(SurfaceSweepTest, ShrinksLargePhotos) {
  for (Camera* camera : {scan_.scene.cameras.data(), &scan_.object.cameras[1]}) {
    camera->width *= 2;
    camera->height *= 2;
    for (double& param : camera->params) param *= 2;
  }
  SweepOptions options;
  options.side_px = kWidth;
  const SurfaceSweep sweep(
      scan_, [&](const std::string& name) { return Photo(name, true, 2); }, options, silent_);
  const std::vector<AlignedTrack> tracks = sweep.Tracks(PhotosLookedIn::kTracks, silent_);
  EXPECT_GT(tracks.size(), 100U);
  EXPECT_LT(Quantile(ErrorsOf(tracks, 2), 0.5), 0.4);  // .20 of the shrunk photos' pixels
}

// A thing that stands still, one that photos do not show, photos that cannot be read, and stations of too
// few.
TEST_F(SurfaceSweepTest, FindsNothingWhereNothingTurns) {
  EXPECT_EQ(SurfaceSweep(
                scan_, [&](const std::string& name) { return Photo(name, false); }, {}, silent_)
                .NumPoints(),
            0);
  EXPECT_EQ(SurfaceSweep(
                scan_, [](const std::string&) { return GreyPhoto(); }, {}, silent_)
                .NumPoints(),
            0);
  for (size_t k = 0; k < scan_.scene.views.size(); ++k)
    scan_.scene.views[k].station = static_cast<int>(k) / 3;
  EXPECT_EQ(SurfaceSweep(
                scan_, [&](const std::string& name) { return Photo(name, true); }, {}, silent_)
                .NumPoints(),
            0);
}

TEST(OptionBounds, Sweep) {
  using S = SweepOptions;
  ExpectBounds(S(), &S::side_px, "side_px", {100}, {99});
  ExpectBounds(S(), &S::radius_px, "radius_px", {2}, {1});
  ExpectBounds(S(), &S::spacing_px, "spacing_px", {1}, {0});
  ExpectBounds(S(), &S::max_seeds, "max_seeds", {1}, {0});
  ExpectBounds(S(), &S::max_turn_deg, "max_turn_deg", {1e-9, 89.9}, {0.0, 90.0, std::nan("")});
  ExpectBounds(S(), &S::min_correlation, "min_correlation", {1e-9, 0.99}, {0.0, 1.0, std::nan("")});
}

TEST_F(SurfaceSweepTest, StopsWhenItIsAskedTo) {
  class Stopping : public Reporter {
   public:
    bool StopRequested() const override { return true; }
  };
  Stopping reporter;
  EXPECT_THROW(SurfaceSweep(
                   scan_, [&](const std::string& name) { return Photo(name, true); }, {}, reporter),
               Interrupted);
}

}  // namespace
}  // namespace s2gs
