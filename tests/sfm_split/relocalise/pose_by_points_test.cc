#include "sfm_split/relocalise/pose_by_points.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <optional>
#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kFocal = 700;
constexpr int kLeast = 20;

const Rigid3 kTruth{Eigen::Quaterniond(0.9, 0.1, -0.3, 0.2).normalized(), Vector3d(0.1, -0.2, 3)};

// Points about the origin, scaled, and where the true camera sees them. The scale is SfM's arbitrary unit.
void MakePoints(const Vector3d& extent, double unit, double noise_px, int count,
                std::vector<Vector3d>* points, std::vector<Vector2d>* seen) {
  RandomNumbers random(7);
  for (int k = 0; k < count; ++k) {
    const Vector3d x = extent.cwiseProduct(Vector3d(random.Normal(), random.Normal(), random.Normal())) +
                       Vector3d(0.2, 0.1, 0);
    points->push_back(unit * x);
    seen->push_back(kFocal * (kTruth * x).hnormalized() +
                    noise_px * Vector2d(random.Normal(), random.Normal()));
  }
}

TEST(PoseByPoints, TheTruePoseComesBackInAnyUnit) {
  for (const double unit : {1e-6, 1.0, 1e6}) {
    std::vector<Vector3d> points;
    std::vector<Vector2d> seen;
    MakePoints({0.4, 0.3, 0.4}, unit, 0, 60, &points, &seen);
    for (int k = 0; k < 15; ++k) seen[static_cast<size_t>(k)] += Vector2d(40, 10 * k - 100);
    const std::optional<PoseByPoints> pose = FitPoseByPoints(points, seen, kFocal, 3, kLeast);
    ASSERT_TRUE(pose.has_value()) << "unit " << unit;
    EXPECT_EQ(pose->inliers, 45);
    EXPECT_EQ(pose->candidates, 60);
    // Measured: 2e-7 degrees, 2e-9 of the distance.
    EXPECT_LT(AngleBetween(pose->cam_from_object.rotation, kTruth.rotation) * 180 / kPi, 1e-5);
    EXPECT_LT((pose->cam_from_object.translation / unit - kTruth.translation).norm(), 1e-6);
  }
}

// OpenCV's SQPnP asserts that points differ by more than a bound of its own.
TEST(PoseByPoints, PointsOnOneSpotOrOnOneLineTellNoPose) {
  for (const double spread : {0.0, 1e-12, 1e-6, 1e-4, 1e-3}) {
    std::vector<Vector3d> points;
    std::vector<Vector2d> seen;
    MakePoints({spread, spread, spread}, 1, 0.3, 30, &points, &seen);
    EXPECT_FALSE(FitPoseByPoints(points, seen, kFocal, 4, kLeast).has_value()) << "spread " << spread;
  }
  for (const double length : {1e-3, 0.05}) {
    std::vector<Vector3d> points;
    std::vector<Vector2d> seen;
    MakePoints({length, 0, 0}, 1, 0.3, 30, &points, &seen);
    EXPECT_NO_THROW(FitPoseByPoints(points, seen, kFocal, 4, kLeast)) << "length " << length;
  }
}

TEST(PoseByPoints, TooFewPointsAndNotANumberTellNoPose) {
  std::vector<Vector3d> points;
  std::vector<Vector2d> seen;
  MakePoints({0.4, 0.3, 0.4}, 1, 0.3, kLeast - 1, &points, &seen);
  EXPECT_FALSE(FitPoseByPoints(points, seen, kFocal, 4, kLeast).has_value());
  EXPECT_FALSE(FitPoseByPoints({}, {}, kFocal, 4, 0).has_value());
  points.emplace_back(std::nan(""), 0, 0);
  seen.emplace_back(0, 0);
  EXPECT_FALSE(FitPoseByPoints(points, seen, kFocal, 4, kLeast).has_value());
}

}  // namespace
}  // namespace s2gs
