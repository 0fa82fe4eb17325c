#include "sfm_split/adjust/points_apart.h"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "sfm_split/base/angles.h"
#include "tests/support/camera_towards_origin.h"
#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kRadius = 0.1;  // of the body, where cameras are 1 away

class PointsApartTest : public testing::Test {
 protected:
  PointsApartTest() {
    camera_.width = 640;
    camera_.height = 480;
    camera_.params = {1500, 1500, 320, 240};
    for (int i = 0; i < 24; ++i) {
      const double angle = kPi / 12 * i;
      const Vector3d center(std::cos(angle), std::sin(angle), 0.4);
      images_.push_back({true, &camera_, CameraTowardsOrigin(center.normalized())});
    }
  }

  // On the body's top or its side.
  Vector3d OnBody() {
    const double angle = random_.Uniform(0, 2 * kPi);
    if (random_.Uniform() < 0.5)
      return kRadius * Vector3d(std::cos(angle), std::sin(angle), random_.Uniform(-1, 1));
    const double radius = kRadius * std::sqrt(random_.Uniform());
    return {radius * std::cos(angle), radius * std::sin(angle), kRadius};
  }

  void Add(const Vector3d& x, size_t num_images) {
    TrackPoint point;
    point.x_in_body = x;
    const size_t first = random_.Index(images_.size());
    for (size_t k = 0; k < num_images; ++k)
      point.track.push_back({static_cast<int>((first + k) % images_.size()), 0});
    points_.push_back(point);
  }

  Vector3d RayIn(const PosedImage& image) {
    const Vector3d in_cam((random_.Uniform(0, 640) - 320) / 1500, (random_.Uniform(0, 480) - 240) / 1500, 1);
    return (image.cam_from_body.rotation.conjugate() * in_cam).normalized();
  }

  // Where the rays of two keypoints anywhere in two neighbouring photos are nearest to each other.
  void AddWrong() {
    for (;;) {
      const size_t first = random_.Index(images_.size());
      const size_t second = (first + 1) % images_.size();
      const Vector3d c1 = CameraCentre(images_[first].cam_from_body);
      const Vector3d c2 = CameraCentre(images_[second].cam_from_body);
      Eigen::Matrix<double, 3, 2> rays;
      rays << RayIn(images_[first]), -RayIn(images_[second]);
      const Vector2d depths = rays.colPivHouseholderQr().solve(c2 - c1);
      if (!(depths.minCoeff() > 0)) continue;
      TrackPoint point;
      point.x_in_body = 0.5 * (c1 + depths[0] * rays.col(0) + c2 - depths[1] * rays.col(1));
      point.track = {{static_cast<int>(first), 0}, {static_cast<int>(second), 0}};
      points_.push_back(point);
      return;
    }
  }

  // How far outside the body, in its radii.
  static double Outside(const Vector3d& x) {
    return std::max(std::hypot(x.x(), x.y()), std::abs(x.z())) / kRadius - 1;
  }

  Camera camera_;
  std::vector<PosedImage> images_;
  std::vector<TrackPoint> points_;
  RandomNumbers random_{7};
};

TEST_F(PointsApartTest, WrongOnesOutsideAreApartAndRightOnesAreNot) {
  for (int k = 0; k < 400; ++k) Add(OnBody(), 3);
  for (int k = 0; k < 800; ++k) Add(OnBody(), 2);
  for (int k = 0; k < 200; ++k) AddWrong();
  const std::vector<bool> apart = PointsApart(images_, points_);
  ASSERT_EQ(apart.size(), points_.size());
  EXPECT_EQ(std::count(apart.begin(), apart.begin() + 400, true), 0);
  EXPECT_LE(std::count(apart.begin() + 400, apart.begin() + 1200, true), 0);
  int outside = 0;
  int found = 0;
  for (size_t p = 1200; p < 1400; ++p) {
    if (!(Outside(points_[p].x_in_body) > 0.5)) continue;
    ++outside;
    found += apart[p] ? 1 : 0;
  }
  EXPECT_GT(outside, 100);
  EXPECT_EQ(found, outside);
}

TEST_F(PointsApartTest, AHandfulOfPointsOnAThinPartAreTheBodys) {
  for (int k = 0; k < 400; ++k) Add(OnBody(), 3);
  // A mast of three radii above the top, with a tenth of its points.
  const auto on_mast = [&] { return Vector3d(0, 0, kRadius * random_.Uniform(1, 4)); };
  for (int k = 0; k < 40; ++k) Add(on_mast(), 3);
  for (int k = 0; k < 80; ++k) Add(on_mast(), 2);
  for (int k = 0; k < 80; ++k) AddWrong();
  const std::vector<bool> apart = PointsApart(images_, points_);
  EXPECT_EQ(std::count(apart.begin() + 440, apart.begin() + 520, true), 0);
  EXPECT_GT(std::count(apart.begin() + 520, apart.end(), true), 40);
}

TEST_F(PointsApartTest, DoesNotDependOnTheUnitOfLength) {
  for (int k = 0; k < 100; ++k) Add(OnBody(), 3);
  for (int k = 0; k < 100; ++k) Add(OnBody(), 2);
  for (int k = 0; k < 50; ++k) AddWrong();
  const std::vector<bool> apart = PointsApart(images_, points_);
  for (PosedImage& image : images_) image.cam_from_body.translation *= 1000;
  for (TrackPoint& point : points_) point.x_in_body *= 1000;
  EXPECT_EQ(PointsApart(images_, points_), apart);
}

TEST_F(PointsApartTest, FewPointsTellNothing) {
  for (int k = 0; k < 19; ++k) Add(OnBody(), 3);
  for (int k = 0; k < 50; ++k) AddWrong();
  std::vector<bool> apart = PointsApart(images_, points_);
  EXPECT_EQ(std::count(apart.begin(), apart.end(), true), 0);
  Add(OnBody(), 3);
  apart = PointsApart(images_, points_);
  EXPECT_GT(std::count(apart.begin(), apart.end(), true), 25);
}

TEST_F(PointsApartTest, NothingIsApartFromOnePlace) {
  for (int k = 0; k < 30; ++k) Add(Vector3d::Zero(), 3);
  Add(Vector3d::Zero(), 2);
  EXPECT_FALSE(PointsApart(images_, points_).back());
  EXPECT_TRUE(PointsApart(images_, {}).empty());
}

}  // namespace
}  // namespace s2gs
