#include "sfm_split/turntable/steady_cameras.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <algorithm>
#include <map>
#include <string>
#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

constexpr uint32_t kCamera = 3;

Camera Lens(double focal, double k1) {
  Camera camera;
  camera.camera_id = kCamera;
  camera.model = CameraModelId::kSimpleRadial;
  camera.width = 640;
  camera.height = 480;
  camera.params = {focal, 320, 240, k1};
  return camera;
}

Eigen::Quaterniond Turn(double degrees) {
  return Eigen::Quaterniond(
      Eigen::AngleAxisd(degrees * kDegree, Eigen::Vector3d(0.5, -0.7, 0.4).normalized()));
}

// What a turn of a pinhole does to its picture.
Eigen::Matrix3d MoveOfPicture(double focal, const Eigen::Quaterniond& turn) {
  Eigen::Matrix3d K;
  K << focal, 0, 320, 0, focal, 240, 0, 0, 1;
  return K * turn.toRotationMatrix() * K.inverse();
}

// A photo before and one after the tripod was knocked, of the same points.
struct Knocked {
  Eigen::Quaterniond turn;
  Rigid3 first_pose;
  Rigid3 second_pose;
  ScanFeatures features;
  ColmapModel model;
};

Knocked Knock(const Camera& camera, double degrees) {
  Knocked scan;
  scan.turn = Turn(degrees);
  scan.first_pose = {Eigen::Quaterniond(Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitX())),
                     Eigen::Vector3d(0.1, -0.2, 4)};
  scan.second_pose = Rigid3{scan.turn, Eigen::Vector3d::Zero()} * scan.first_pose;
  scan.features.cameras[kCamera] = camera;
  scan.model.cameras[kCamera] = camera;
  RandomNumbers random(7);
  std::vector<Eigen::Vector3d> points;
  for (int k = 0; k < 50; ++k)
    points.emplace_back(random.Uniform(-1, 1), random.Uniform(-1, 1), random.Uniform(-1, 1));
  uint32_t id = 0;
  for (const Rigid3& pose : {scan.first_pose, scan.second_pose}) {
    ScanImage image;
    image.name = id == 0 ? "first.jpg" : "second.jpg";
    image.camera_id = kCamera;
    if (id == 1) image.photo_from_first = MoveOfPicture(camera.params[0], scan.turn);
    ColmapImage placed;
    placed.image_id = ++id;
    placed.name = image.name;
    placed.camera_id = kCamera;
    placed.cam_from_world = pose;
    for (const Eigen::Vector3d& x : points) {
      const Eigen::Vector2d xy = ProjectToImage(camera, pose * x).value();
      image.keypoints.emplace_back(xy.cast<float>());
      placed.points2D.push_back({xy});
    }
    scan.features.images.push_back(image);
    scan.model.images[id] = placed;
  }
  return scan;
}

double LargestDistance(const Keypoints& a, const Keypoints& b) {
  double largest = 0;
  for (size_t k = 0; k < a.size(); ++k) largest = std::max<double>(largest, (a[k] - b[k]).norm());
  return largest;
}

TEST(SteadyCameras, KeypointsLieWhereTheFirstPhotoHasThem) {
  const Knocked scan = Knock(Lens(700, 0), 0.5);
  const SteadyCameras cameras(scan.features, {});
  ASSERT_TRUE(cameras.AnyMoved());
  EXPECT_NEAR(cameras.LargestTurn() / kDegree, 0.5, 1e-9);
  EXPECT_GT(LargestDistance(scan.features.images[0].keypoints, scan.features.images[1].keypoints), 5);
  const ScanFeatures steady = cameras.Steady(scan.features);
  EXPECT_EQ(LargestDistance(steady.images[0].keypoints, scan.features.images[0].keypoints), 0);
  // Measured 6e-5: floats of up to 640.
  EXPECT_LT(LargestDistance(steady.images[0].keypoints, steady.images[1].keypoints), 2e-4);
}

TEST(SteadyCameras, ALensWithDistortionOrAnotherFocalLengthIsOfSecondOrder) {
  const Knocked scan = Knock(Lens(700, 0), 0.5);
  // Steadied by intrinsics that are wrong by a tenth, and by a distortion that is not there: the picture
  // moves by 6 px in its middle.
  for (const Camera& wrong : {Lens(770, 0), Lens(700, -0.1)}) {
    const SteadyCameras cameras(scan.features, {{kCamera, wrong}});
    const ScanFeatures steady = cameras.Steady(scan.features);
    EXPECT_LT(LargestDistance(steady.images[0].keypoints, steady.images[1].keypoints), 0.3);
  }
}

// A model of a few photos may ask for any lens; the stated one moves the picture as it was measured.
TEST(SteadyCameras, ALensThatMovesThePictureOtherwiseIsNotTaken) {
  const Knocked scan = Knock(Lens(700, 0), 0.5);
  for (const Camera& absurd : {Lens(700, -1.2), Lens(60, 0)}) {
    const SteadyCameras cameras(scan.features, {{kCamera, absurd}});
    EXPECT_NEAR(cameras.LargestTurn() / kDegree, 0.5, 1e-9);
    const ScanFeatures steady = cameras.Steady(scan.features);
    EXPECT_LT(LargestDistance(steady.images[0].keypoints, steady.images[1].keypoints), 2e-4);
  }
}

TEST(SteadyCameras, PosesOfAReconstructionAreThoseOfTheFirstPhoto) {
  const Knocked scan = Knock(Lens(700, -0.1), 0.3);
  const SteadyCameras cameras(scan.features, scan.model.cameras);
  const ColmapModel steady = cameras.Steady(scan.model);
  const Rigid3& pose = steady.images.at(2).cam_from_world;
  // The move of the picture is a pinhole's, the lens none. Measured .0062 degrees.
  EXPECT_LT(AngleBetween(pose.rotation, scan.first_pose.rotation) / kDegree, 0.01);
  EXPECT_LT((CameraCentre(pose) - CameraCentre(scan.first_pose)).norm(), 1e-12);
  for (size_t k = 0; k < 50; ++k) {
    EXPECT_LT((steady.images.at(2).points2D[k].xy - steady.images.at(1).points2D[k].xy).norm(), 0.2);
  }
}

TEST(SteadyCameras, ShakingTakesAllBack) {
  const Knocked scan = Knock(Lens(700, 0), 0.5);
  const SteadyCameras cameras(scan.features, {});
  AlignedScene aligned;
  aligned.object = cameras.Steady(scan.model);
  aligned.scene.cameras = {Lens(700, 0)};
  View view;
  view.name = "second.jpg";
  view.camera_id = kCamera;
  view.cam_from_world = scan.first_pose;
  aligned.scene.views = {view};
  cameras.Shake(&aligned);
  const Eigen::Quaterniond& rotation = aligned.object.images.at(2).cam_from_world.rotation;
  EXPECT_LT(AngleBetween(rotation, scan.second_pose.rotation), 1e-9);
  EXPECT_LT(AngleBetween(aligned.scene.views[0].cam_from_world.rotation, scan.second_pose.rotation), 1e-9);
  for (size_t k = 0; k < 50; ++k) {
    EXPECT_LT((aligned.object.images.at(2).points2D[k].xy - scan.model.images.at(2).points2D[k].xy).norm(),
              1e-9);
  }
}

// The picture moved as it was measured: with twice the focal length half the turn does it.
TEST(SteadyCameras, ShakingFollowsTheFocalLengthThatWasFound) {
  const Knocked scan = Knock(Lens(700, 0), 0.5);
  const SteadyCameras cameras(scan.features, {});
  AlignedScene aligned;
  aligned.scene.cameras = {Lens(1400, 0)};
  View view;
  view.name = "second.jpg";
  view.camera_id = kCamera;
  aligned.scene.views = {view};
  cameras.Shake(&aligned);
  const Eigen::Matrix3d R = aligned.scene.views[0].cam_from_world.rotation.toRotationMatrix();
  const Eigen::Matrix3d expected = scan.turn.toRotationMatrix();
  // Measured .525: at the borders the picture moves by a little more than in its middle.
  EXPECT_NEAR(R(0, 2) / expected(0, 2), 0.5, 0.04);
  EXPECT_NEAR(R(1, 2) / expected(1, 2), 0.5, 0.04);
  EXPECT_NEAR(R(0, 1) / expected(0, 1), 1.0, 0.04);  // in the picture's plane the focal length has no part
}

TEST(SteadyCameras, ACameraThatStoodStillIsLeftAlone) {
  const Knocked scan = Knock(Lens(700, -0.1), 0);
  ScanFeatures features = scan.features;
  features.images[1].photo_from_first.setIdentity();
  const SteadyCameras cameras(features, scan.model.cameras);
  EXPECT_FALSE(cameras.AnyMoved());
  EXPECT_EQ(cameras.LargestTurn(), 0);
  EXPECT_EQ(LargestDistance(cameras.Steady(features).images[1].keypoints, features.images[1].keypoints), 0);
}

}  // namespace
}  // namespace s2gs
