#include "sfm_split/photo_tracks/patch_alignment.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <functional>
#include <random>

#include "sfm_split/adjust/track_triangulation.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/scene/projection_jacobians.h"
#include "tests/support/camera_towards_origin.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr int kSide = 70;

// A picture on the plane z = 0, in waves of 5 to 12 mm.
double Texture(double x, double y) {
  double sum = 0;
  for (int k = 0; k < 9; ++k) {
    const double along = 0.7 * k + 0.3;
    const double wave = 2 * kPi / (0.005 + 0.0008 * k);
    sum += std::sin(wave * (std::cos(along) * x + std::sin(along) * y) + 1.3 * k);
  }
  return sum / 3;
}

Camera TestCamera() {
  Camera camera;
  camera.camera_id = 1;
  camera.model = CameraModelId::kSimpleRadial;
  camera.width = kSide;
  camera.height = kSide;
  camera.params = {700, kSide / 2.0, kSide / 2.0, 0.05};
  return camera;
}

// From 0.6 m off, looking at the origin.
Rigid3 LookFrom(double azimuth_deg, double elevation_deg) {
  const double a = azimuth_deg * kDegree;
  const double e = elevation_deg * kDegree;
  return CameraTowardsOrigin(0.6 *
                             Vector3d(std::cos(e) * std::cos(a), std::cos(e) * std::sin(a), std::sin(e)));
}

// What falls on the plane, besides by gain and offset: the texture's contrast and the light's slopes.
struct Light {
  double contrast = 40;
  Vector2d slope_per_m = Vector2d::Zero();
};

// Of four rays a pixel, which stand for its area.
PhotoPart Render(const Camera& camera, const Rigid3& pose, double gain, double offset, double noise,
                 std::mt19937* random, const Light& light = {}) {
  std::normal_distribution<double> normal(0, 1);
  PhotoPart part{0, 0, kSide, kSide, {}};
  const Vector3d centre = CameraCentre(pose);
  for (int j = 0; j < kSide; ++j) {
    for (int i = 0; i < kSide; ++i) {
      double sum = 0;
      for (int s = 0; s < 4; ++s) {
        const Vector2d xy((i + (s % 2 + 0.5) / 2 - camera.params[1]) / camera.params[0],
                          (j + (s / 2 + 0.5) / 2 - camera.params[2]) / camera.params[0]);
        Vector2d undistorted = xy;
        for (int k = 0; k < 8; ++k) undistorted = xy / (1 + camera.params[3] * undistorted.squaredNorm());
        const Vector3d ray = pose.rotation.conjugate() * undistorted.homogeneous();
        const Vector3d hit = centre - centre.z() / ray.z() * ray;
        sum += (1 + light.slope_per_m.dot(hit.head<2>())) *
               (120 + light.contrast * Texture(hit.x(), hit.y())) / 4;
      }
      const double grey = gain * sum + offset + noise * normal(*random);
      part.grey.push_back(static_cast<uint8_t>(std::clamp(std::lround(grey), 0L, 255L)));
    }
  }
  return part;
}

struct Scan {
  Camera camera = TestCamera();
  std::vector<SplinePart> photos;
  std::vector<Rigid3> poses;
  std::vector<PatchView> views;
};

Scan MakeScan(double noise, uint32_t seed) {
  std::mt19937 random(seed);
  Scan scan;
  for (const auto& [azimuth, elevation] :
       {std::pair{0.0, 70.0}, {40.0, 55.0}, {90.0, 50.0}, {150.0, 60.0}, {210.0, 45.0}, {300.0, 58.0}}) {
    scan.poses.push_back(LookFrom(azimuth, elevation));
    const double gain = 0.8 + 0.05 * static_cast<double>(scan.poses.size());
    scan.photos.emplace_back(Render(scan.camera, scan.poses.back(), gain, 10 - azimuth / 30, noise, &random));
  }
  return scan;
}

void Look(Scan* scan) {
  scan->views.clear();
  for (size_t k = 0; k < scan->photos.size(); ++k)
    scan->views.push_back({&scan->photos[k], &scan->camera, scan->poses[k]});
}

// Distances of places from where their views show one common point, which they themselves tell.
double RmsOfCommonPoint(const Scan& scan, const std::vector<Rigid3>& true_poses,
                        const std::vector<PatchPlace>& places, Vector3d x) {
  std::vector<PosedImage> images;
  std::vector<Keypoints> keypoints;
  std::vector<TrackElement> track;
  for (size_t k = 0; k < places.size(); ++k) {
    images.push_back({true, &scan.camera, true_poses[k]});
    keypoints.push_back({places[k].xy.cast<float>()});
    track.push_back({static_cast<int>(k), 0});
  }
  EXPECT_TRUE(RefinePoint(images, keypoints, track, &x));
  double squares = 0;
  for (size_t k = 0; k < places.size(); ++k)
    squares += std::pow(ReprojectionErrorPx(images[k], x, places[k].xy), 2);
  return std::sqrt(squares / static_cast<double>(2 * places.size() - 3));
}

// .0026 px measured.
TEST(PatchAlignment, FindsOnePointOfAPlaneWithoutNoise) {
  Scan scan = MakeScan(0, 1);
  Look(&scan);
  SurfacePatch patch{Vector3d::Zero(), Vector3d::UnitZ()};
  const std::vector<PatchPlace> places = AlignPatch(scan.views, 0, {}, &patch);
  for (const PatchPlace& place : places) {
    EXPECT_TRUE(place.is_found);
    EXPECT_GT(place.correlation, 0.99);
  }
  EXPECT_LT(RmsOfCommonPoint(scan, scan.poses, places, patch.centre), 0.01);
}

TEST(PatchAlignment, TurnsAWrongNormal) {
  Scan scan = MakeScan(0, 1);
  Look(&scan);
  SurfacePatch patch{Vector3d::Zero(), Vector3d(0.25, -0.2, 1).normalized()};
  const std::vector<PatchPlace> places = AlignPatch(scan.views, 0, {}, &patch);
  EXPECT_LT(std::acos(patch.normal.z()) / kDegree, 1.0);
  EXPECT_LT(RmsOfCommonPoint(scan, scan.poses, places, patch.centre), 0.01);
}

TEST(PatchAlignment, UndoesPosesThatAreOffBySubpixels) {
  Scan scan = MakeScan(0, 1);
  const std::vector<Rigid3> true_poses = scan.poses;
  for (size_t k = 0; k < scan.poses.size(); ++k) {
    const double angle = (k % 2 == 0 ? 0.4 : -0.7) / 700;  // .28 and .49 px
    const Vector3d axis(std::cos(1.1 * static_cast<double>(k)), std::sin(1.1 * static_cast<double>(k)), 0);
    const Eigen::Quaterniond turn(Eigen::AngleAxisd(angle, axis));
    scan.poses[k] = {turn * scan.poses[k].rotation, turn * scan.poses[k].translation};
  }
  Look(&scan);
  SurfacePatch patch{Vector3d(0, 0, 0.0003), Vector3d::UnitZ()};
  const std::vector<PatchPlace> places = AlignPatch(scan.views, 0, {}, &patch);
  for (const PatchPlace& place : places) EXPECT_TRUE(place.is_found);
  EXPECT_LT(RmsOfCommonPoint(scan, true_poses, places, patch.centre), 0.01);
}

TEST(PatchAlignment, StatesItsOwnNoise) {
  double squares = 0;
  double stated = 0;
  for (uint32_t seed = 0; seed < 8; ++seed) {
    Scan scan = MakeScan(4, seed);
    Look(&scan);
    SurfacePatch patch{Vector3d::Zero(), Vector3d::UnitZ()};
    const std::vector<PatchPlace> places = AlignPatch(scan.views, 0, {}, &patch);
    squares += std::pow(RmsOfCommonPoint(scan, scan.poses, places, patch.centre), 2) / 8;
    for (const PatchPlace& place : places) {
      ASSERT_TRUE(place.is_found);
      stated += std::pow(place.sigma_px, 2) / 48;
    }
  }
  EXPECT_GT(std::sqrt(stated / squares), 0.7);
  EXPECT_LT(std::sqrt(stated / squares), 2);
}

// Shades that stay in the world while the plane turns: 1.5 grey levels a pixel, beside a texture of 5.
TEST(PatchAlignment, TellsLightThatSlopesFromAShift) {
  Scan scan = MakeScan(0, 1);
  std::mt19937 random(1);
  for (size_t k = 0; k < scan.photos.size(); ++k) {
    const double a = 2 * kPi * static_cast<double>(k) / static_cast<double>(scan.photos.size());
    const Light light = {5, 15 * Vector2d(std::cos(a), std::sin(a))};
    scan.photos[k] = SplinePart(Render(scan.camera, scan.poses[k], 0.9, 0, 0, &random, light));
  }
  Look(&scan);
  SurfacePatch patch{Vector3d::Zero(), Vector3d::UnitZ()};
  const std::vector<PatchPlace> places = AlignPatch(scan.views, 0, {}, &patch);
  for (const PatchPlace& place : places) ASSERT_TRUE(place.is_found);
  EXPECT_LT(RmsOfCommonPoint(scan, scan.poses, places, patch.centre), 0.1);
}

TEST(PatchAlignment, LeavesOutAPhotoOfSomethingElse) {
  Scan scan = MakeScan(2, 5);
  std::mt19937 random(9);
  PhotoPart other = Render(scan.camera, scan.poses[3], 1, 0, 2, &random);
  std::reverse(other.grey.begin(), other.grey.end());
  scan.photos[3] = SplinePart(other);
  Look(&scan);
  SurfacePatch patch{Vector3d::Zero(), Vector3d::UnitZ()};
  const std::vector<PatchPlace> places = AlignPatch(scan.views, 0, {}, &patch);
  for (size_t k = 0; k < places.size(); ++k) EXPECT_EQ(places[k].is_found, k != 3);
}

TEST(PatchAlignment, FindsNothingInPlainPhotos) {
  Scan scan = MakeScan(2, 5);
  for (SplinePart& photo : scan.photos)
    photo = SplinePart({0, 0, kSide, kSide, std::vector<uint8_t>(kSide * kSide, 90)});
  Look(&scan);
  SurfacePatch patch{Vector3d::Zero(), Vector3d::UnitZ()};
  for (const PatchPlace& place : AlignPatch(scan.views, 0, {}, &patch)) EXPECT_FALSE(place.is_found);
}

}  // namespace
}  // namespace s2gs
