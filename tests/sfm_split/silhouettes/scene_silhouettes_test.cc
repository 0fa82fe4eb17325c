#include "sfm_split/silhouettes/scene_silhouettes.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/error.h"
#include "sfm_split/scene/axis_turn.h"
#include "tests/support/camera_towards_origin.h"
#include "tests/support/still_squares.h"

namespace s2gs {
namespace {

using Eigen::Vector3d;

constexpr int kWidth = 160;
constexpr int kHeight = 120;
constexpr int kPhotos = 16;

struct Ball {
  Vector3d centre;
  double radius;
};
const std::vector<Ball> kThing = {
    {{0.1, 0, 0}, 0.35}, {{0.5, 0.1, 0.2}, 0.18}, {{-0.2, 0.45, -0.1}, 0.22}, {{0, -0.2, 0.5}, 0.2}};

// Two stations before a thing of four balls. By the poses the second begins where the first does.
class SceneSilhouettes : public testing::Test {
 protected:
  SceneSilhouettes() {
    Camera camera;
    camera.camera_id = 1;
    camera.model = CameraModelId::kSimplePinhole;
    camera.width = kWidth;
    camera.height = kHeight;
    camera.params = {200, kWidth / 2.0, kHeight / 2.0};
    scene_.cameras = {camera};
    scene_.num_stations = 2;
    for (const int station : {0, 1}) {
      const double azimuth = station * 25 * kDegree;
      const double elevation = (15 + 25 * station) * kDegree;
      for (int k = 0; k < kPhotos; ++k) {
        View view;
        view.name = std::to_string(station) + "_" + std::to_string(10 + k);
        view.camera_id = 1;
        view.station = station;
        view.angle_deg = 360.0 * k / kPhotos;
        view.cam_from_world =
            CameraTowardsOrigin(4 * Vector3d(std::cos(elevation) * std::cos(azimuth),
                                             std::cos(elevation) * std::sin(azimuth), std::sin(elevation)));
        view.world_from_object = TurnAbout(scene_.axis, view.angle_deg * kDegree);
        scene_.views.push_back(view);
      }
    }
  }

  // Before the second station the thing has turned farther than the poses say.
  GreyPhoto Photo(const std::string& name, double turn_deg) const {
    const View& view = *std::find_if(scene_.views.begin(), scene_.views.end(),
                                     [&](const View& v) { return v.name == name; });
    const Rigid3 cam_from_thing =
        view.CamFromObject() * TurnAbout(scene_.axis, view.station * turn_deg * kDegree);
    const Vector3d origin = CameraCentre(cam_from_thing);
    GreyPhoto photo{kWidth, kHeight, {}};
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const Vector3d ray(x + 0.5 - kWidth / 2.0, y + 0.5 - kHeight / 2.0, 200);
        const Vector3d direction = (cam_from_thing.rotation.inverse() * ray).normalized();
        const bool is_thing = std::any_of(kThing.begin(), kThing.end(), [&](const Ball& ball) {
          return (ball.centre - origin).cross(direction).norm() < ball.radius;
        });
        photo.grey.push_back(
            static_cast<uint8_t>(is_thing ? 120 + 60 * std::sin(0.5 * x + view.angle_deg) * std::sin(0.4 * y)
                                          : StillSquares(x, y)));
      }
    }
    return photo;
  }

  TurntableScene scene_;
  Reporter silent_;
};

TEST_F(SceneSilhouettes, TellHowAStationIsTurnedByItsPhotos) {
  for (const double turn_deg : {70.0, -30.0}) {
    const std::map<int, SilhouetteTurn> turns =
        AskSilhouettes([&](const std::string& name) { return Photo(name, turn_deg); }, scene_, {1}, silent_);
    ASSERT_EQ(turns.size(), 1U);
    const SilhouetteTurn& turn = turns.at(1);
    EXPECT_TRUE(turn.is_told) << turn.t;
    EXPECT_LT(std::abs(WrapAngle(turn.turn_rad - turn_deg * kDegree)), 3 * turn.sigma_rad) << turn_deg;
  }
}

// What cannot be read, or has another size, is left out; views of a camera that is unknown, too.
TEST_F(SceneSilhouettes, LeaveOutWhatDoesNotFit) {
  View stranger = scene_.views.back();
  stranger.name = "stranger";
  stranger.camera_id = 7;
  scene_.views.push_back(stranger);
  const auto read = [&](const std::string& name) {
    if (name == "0_12" || name == "1_15") return GreyPhoto();
    if (name == "1_13") return GreyPhoto{2, 2, std::vector<uint8_t>(4, 0)};
    return Photo(name, 70);
  };
  const SilhouetteTurn turn = AskSilhouettes(read, scene_, {1}, silent_).at(1);
  EXPECT_TRUE(turn.is_told) << turn.t;
  EXPECT_LT(std::abs(WrapAngle(turn.turn_rad - 70 * kDegree)), 3 * turn.sigma_rad);
  EXPECT_FALSE(
      AskSilhouettes([](const std::string&) { return GreyPhoto(); }, scene_, {1}, silent_).at(1).is_told);
  EXPECT_TRUE(AskSilhouettes(read, {}, {1}, silent_).empty());
}

TEST_F(SceneSilhouettes, StopsWhenItIsAskedTo) {
  class Stopping : public Reporter {
   public:
    bool StopRequested() const override { return true; }
  };
  Stopping reporter;
  EXPECT_THROW(AskSilhouettes([&](const std::string& name) { return Photo(name, 0); }, scene_, {1}, reporter),
               Interrupted);
}

}  // namespace
}  // namespace s2gs
