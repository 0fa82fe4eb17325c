#include "sfm_split/scene/pose_error.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "sfm_split/base/angles.h"

namespace s2gs {
namespace {

using Eigen::AngleAxisd;
using Eigen::Quaterniond;
using Eigen::Vector3d;

Quaterniond RandomRotation(std::mt19937& random) {
  std::normal_distribution<double> normal;
  return Quaterniond(normal(random), normal(random), normal(random), normal(random)).normalized();
}

Vector3d RandomVector(std::mt19937& random) {
  std::normal_distribution<double> normal;
  return {normal(random), normal(random), normal(random)};
}

std::vector<Vector3d> RandomVectors(int count, std::mt19937& random) {
  std::vector<Vector3d> vectors;
  for (int i = 0; i < count; ++i) vectors.push_back(RandomVector(random));
  return vectors;
}

double SumOfSquares(const Sim3& b_from_a, const std::vector<Vector3d>& a, const std::vector<Vector3d>& b) {
  double sum = 0;
  for (size_t i = 0; i < a.size(); ++i) sum += (b_from_a * a[i] - b[i]).squaredNorm();
  return sum;
}

Rigid3 LookFrom(const Vector3d& centre, const Quaterniond& rotation) {
  return {rotation, -(rotation * centre)};
}

// The same cameras in a frame that `truth_from_estimate` leads back from.
Rigid3 InEstimateFrame(const Rigid3& cam_from_truth, const Sim3& truth_from_estimate) {
  const Vector3d centre = truth_from_estimate.Inverse() * CameraCentre(cam_from_truth);
  return LookFrom(centre, cam_from_truth.rotation * truth_from_estimate.rotation);
}

Rigid3 TurnedInPlace(const Rigid3& pose, double degrees, const Vector3d& axis) {
  const Quaterniond turn(AngleAxisd(degrees * kDegree, axis.normalized()));
  return LookFrom(CameraCentre(pose), turn * pose.rotation);
}

PoseMap RandomPoses(int count, std::mt19937& random) {
  PoseMap poses;
  for (int i = 0; i < count; ++i) {
    poses["a" + std::to_string(i) + ".jpg"] = LookFrom(RandomVector(random), RandomRotation(random));
  }
  return poses;
}

TEST(FitSim3, RecoversAnExactSimilarity) {
  std::mt19937 random(1);
  for (const double scale : {1e-3, 1.0, 1e3}) {
    const Sim3 b_from_a{scale, RandomRotation(random), 5 * RandomVector(random)};
    const std::vector<Vector3d> a = RandomVectors(10, random);
    std::vector<Vector3d> b;
    for (const Vector3d& x : a) b.push_back(b_from_a * x);
    const Sim3Fit fit = FitSim3(a, b);
    ASSERT_EQ(fit.status, FitStatus::kOk);
    // Measured: below 4e-13 relative at the worst scale.
    EXPECT_NEAR(fit.b_from_a.scale, scale, 1e-11 * scale);
    EXPECT_LT(RotationAngleDeg(fit.b_from_a.rotation * b_from_a.rotation.conjugate()), 1e-9);
    EXPECT_LT((fit.b_from_a.translation - b_from_a.translation).norm(), 1e-11 * std::max(scale, 1.0));
  }
}

TEST(FitSim3, NoNeighbouringSimilarityIsBetter) {
  std::mt19937 random(2);
  for (const bool is_mirrored : {false, true}) {
    for (const bool is_planar : {false, true}) {
      std::vector<Vector3d> a = RandomVectors(12, random);
      if (is_planar) {
        for (Vector3d& x : a) x.z() = 0;
      }
      std::vector<Vector3d> b;
      for (const Vector3d& x : a) {
        b.push_back(2 * Vector3d(is_mirrored ? -x.x() : x.x(), x.y(), x.z()) + 0.1 * RandomVector(random));
      }
      const Sim3Fit fit = FitSim3(a, b);
      ASSERT_EQ(fit.status, FitStatus::kOk);
      const double best = SumOfSquares(fit.b_from_a, a, b);
      for (int trial = 0; trial < 200; ++trial) {
        Sim3 other = fit.b_from_a;
        const double step = std::pow(10.0, -4 + trial % 4);
        other.scale *= 1 + step * RandomVector(random).x();
        other.rotation = Quaterniond(AngleAxisd(step, RandomVector(random).normalized())) * other.rotation;
        other.translation += step * RandomVector(random);
        EXPECT_GE(SumOfSquares(other, a, b), best * (1 - 1e-12));
      }
    }
  }
}

TEST(FitSim3, DegenerateSetsAreReported) {
  const Vector3d x(1, 2, 3), y(2, -1, 0.5), z(0, 1, 1);
  EXPECT_EQ(FitSim3({}, {}).status, FitStatus::kCoincident);
  EXPECT_EQ(FitSim3({x}, {y}).status, FitStatus::kCoincident);
  EXPECT_EQ(FitSim3({x, x, x}, {x, y, z}).status, FitStatus::kCoincident);
  EXPECT_EQ(FitSim3({x, y, z}, {y, y, y}).status, FitStatus::kCoincident);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(FitSim3({x, y, {0, nan, 0}}, {x, y, z}).status, FitStatus::kNotFinite);
  EXPECT_EQ(FitSim3({x, y, z}, {x, y, {HUGE_VAL, 0, 0}}).status, FitStatus::kNotFinite);
}

TEST(FitSim3, OnALineTheScaleAloneIsKnown) {
  const Vector3d origin(1, 2, 3), along(0.3, -0.2, 0.9), other_along(0.9, 0.3, 0.2);
  std::vector<Vector3d> a, b;
  for (const double t : {-1.0, 0.5, 2.0, 2.5}) {
    a.push_back(origin + t * along);
    b.push_back(2 * origin + 3 * t * other_along);
  }
  const double scale = 3 * other_along.norm() / along.norm();
  const Sim3Fit line = FitSim3(a, b);
  EXPECT_EQ(line.status, FitStatus::kCollinear);
  EXPECT_NEAR(line.b_from_a.scale, scale, 1e-12 * scale);
  // Two places, several cameras at each: two stations.
  const Sim3Fit stations = FitSim3({a[0], a[0], a[3], a[3], a[3]}, {b[0], b[0], b[3], b[3], b[3]});
  EXPECT_EQ(stations.status, FitStatus::kCollinear);
  EXPECT_NEAR(stations.b_from_a.scale, scale, 1e-12 * scale);
  // Noise in the estimate does not make three dimensions of two true places.
  a[0] += Vector3d(1e-3, 2e-3, -1e-3);
  EXPECT_EQ(FitSim3({a[0], a[0], a[3], a[3]}, {b[0], b[0], b[3], b[3]}).status, FitStatus::kCollinear);
}

TEST(FitSim3, ShakeWithinTheExtentIsOnePlace) {
  std::mt19937 random(3);
  const std::vector<Vector3d> a = RandomVectors(20, random);
  std::vector<Vector3d> b;
  for (const Vector3d& x : a) b.push_back(Vector3d(1, 2, 3) + 1e-6 * x);
  EXPECT_EQ(FitSim3(a, b).status, FitStatus::kOk);
  EXPECT_EQ(FitSim3(a, b, 1e-5).status, FitStatus::kCoincident);
}

TEST(ComparePoses, InjectedRotationErrorsAreMeasured) {
  std::mt19937 random(4);
  const PoseMap truth = RandomPoses(8, random);
  const Sim3 truth_from_estimate{0.37, RandomRotation(random), RandomVector(random)};
  PoseMap estimate;
  std::vector<double> injected;
  for (const auto& [name, pose] : truth) {
    const double degrees = std::pow(10.0, -6.0 + static_cast<double>(injected.size()));  // 1e-6 to 10.
    injected.push_back(degrees);
    estimate[name] = TurnedInPlace(InEstimateFrame(pose, truth_from_estimate), degrees, RandomVector(random));
  }
  estimate["not in the truth.jpg"] = Rigid3();
  const PoseErrors errors = ComparePoses(estimate, truth);
  ASSERT_EQ(errors.truth_from_estimate.status, FitStatus::kOk);
  ASSERT_EQ(errors.names.size(), truth.size());
  for (size_t i = 0; i < injected.size(); ++i) {
    // Measured: 2e-14 degrees.
    EXPECT_NEAR(errors.rotation_deg[i], injected[i], 1e-12);
    EXPECT_LT(errors.centre_length[i], 1e-14);
  }
}

// Offsets e of the estimate's centres with sum e = 0 and sum e b^T = 0 leave the rotation of the fit
// untouched and shrink its scale to var(b) / (var(b) + var(e)).
TEST(ComparePoses, InjectedCentreErrorsAreMeasured) {
  const Vector3d offset(0.02, -0.01, 0.03);
  PoseMap truth, estimate;
  std::map<std::string, Vector3d> centres, moved;
  for (int axis = 0; axis < 3; ++axis) {
    for (const double sign : {-1.0, 1.0}) {
      for (const double side : {-1.0, 1.0}) {
        const std::string name = std::to_string(centres.size());
        centres[name] = sign * Vector3d::Unit(axis);
        moved[name] = centres[name] + side * offset;
        truth[name] = LookFrom(centres[name], Quaterniond::Identity());
        estimate[name] = LookFrom(moved[name], Quaterniond::Identity());
      }
    }
  }
  const PoseErrors errors = ComparePoses(estimate, truth);
  const double scale = 1 / (1 + offset.squaredNorm());
  EXPECT_NEAR(errors.truth_from_estimate.b_from_a.scale, scale, 1e-14);
  for (size_t i = 0; i < errors.names.size(); ++i) {
    EXPECT_NEAR(errors.centre_length[i], (scale * moved[errors.names[i]] - centres[errors.names[i]]).norm(),
                1e-14);
    EXPECT_LT(errors.rotation_deg[i], 1e-12);
  }
}

TEST(ComparePoses, OneAndTwoImagesAreNotMeasured) {
  std::mt19937 random(5);
  const PoseMap one = RandomPoses(1, random);
  EXPECT_EQ(ComparePoses(one, one).truth_from_estimate.status, FitStatus::kCoincident);
  EXPECT_TRUE(ComparePoses(one, one).rotation_deg.empty());
  const PoseMap two = RandomPoses(2, random);
  EXPECT_EQ(ComparePoses(two, two).truth_from_estimate.status, FitStatus::kCollinear);
  EXPECT_TRUE(ComparePoses(two, two).rotation_deg.empty());
  EXPECT_EQ(ComparePoses({}, two).names.size(), 0u);
}

TEST(RotationAngleDeg, AccurateOverTheWholeRange) {
  for (const double degrees : {0.0, 1e-9, 1e-4, 1.0, 90.0, 179.9999, 180.0}) {
    const Quaterniond q(AngleAxisd(degrees * kDegree, Vector3d(1, -2, 0.5).normalized()));
    EXPECT_NEAR(RotationAngleDeg(q), degrees, 1e-13 * std::max(1.0, degrees));
    EXPECT_NEAR(RotationAngleDeg(Quaterniond(-q.coeffs())), degrees, 1e-13 * std::max(1.0, degrees));
  }
}

class TurntableAngles : public ::testing::TestWithParam<int> {};

TEST_P(TurntableAngles, InjectedErrorsAreMeasuredInEitherSense) {
  const int sense = GetParam();
  std::mt19937 random(6);
  const Vector3d true_axis(0.1, 0.2, 2);
  const Vector3d estimated_axis = RandomVector(random).normalized();
  std::vector<Quaterniond> truth, estimate;
  const double offset = 77;  // both count from a different image.
  for (int i = 0; i < 20; ++i) {
    const double degrees = 18.0 * i;
    const double error = i % 2 == 0 ? 0.3 : -0.3;
    truth.emplace_back(AngleAxisd(degrees * kDegree, true_axis.normalized()));
    estimate.emplace_back(AngleAxisd(sense * (degrees + error + offset) * kDegree, estimated_axis));
  }
  const std::vector<double> errors = TurntableAngleErrorsDeg(estimate, truth, true_axis);
  ASSERT_EQ(errors.size(), 20u);
  for (const double error : errors) EXPECT_NEAR(error, 0.3, 1e-10);
}

INSTANTIATE_TEST_SUITE_P(Senses, TurntableAngles, ::testing::Values(1, -1));

TEST(TurntableAngles, TooFewStuckAndMeanless) {
  const std::vector<Quaterniond> one = {Quaterniond::Identity()};
  EXPECT_TRUE(TurntableAngleErrorsDeg({}, {}, Vector3d::UnitZ()).empty());
  EXPECT_TRUE(TurntableAngleErrorsDeg(one, one, Vector3d::UnitZ()).empty());
  // An estimate that never turns, of a table that turns all round: no mean offset exists, yet errors do.
  std::vector<Quaterniond> truth, stuck;
  for (int i = 0; i < 4; ++i) {
    truth.emplace_back(AngleAxisd(90 * i * kDegree, Vector3d::UnitZ()));
    stuck.push_back(Quaterniond::Identity());
  }
  const std::vector<double> errors = TurntableAngleErrorsDeg(stuck, truth, Vector3d::UnitZ());
  ASSERT_EQ(errors.size(), 4u);
  double sum = 0;
  for (const double error : errors) sum += error;
  EXPECT_NEAR(sum, 0 + 90 + 180 + 90, 1e-9);
  // Two images half a turn apart: the axis cannot be seen, the angle can.
  const std::vector<double> half =
      TurntableAngleErrorsDeg({truth[0], truth[2]}, {truth[0], truth[2]}, Vector3d::UnitZ());
  EXPECT_NEAR(half[0] + half[1], 0, 1e-9);
}

TEST(CompareAxes, TiltAndOffset) {
  const Sim3 truth_from_estimate{2, Quaterniond(AngleAxisd(0.4, Vector3d(1, 1, 0).normalized())),
                                 Vector3d(0.1, -0.2, 0.3)};
  const TurntableAxis truth{Vector3d(1, 2, 3), Vector3d::UnitZ()};
  for (const double sign : {1.0, -1.0}) {
    // Through a point 0.05 beside the true one, tilted by 2 degrees within the plane across the offset.
    const Vector3d direction(0, std::sin(2 * kDegree), std::cos(2 * kDegree));
    const Vector3d point = truth.point + Vector3d(0.05, 0, 0) + 7 * direction;
    const TurntableAxis estimate{truth_from_estimate.Inverse() * point,
                                 sign * (truth_from_estimate.rotation.conjugate() * direction)};
    const AxisError error = CompareAxes(estimate, truth, truth_from_estimate);
    EXPECT_NEAR(error.direction_deg, 2, 1e-10);
    EXPECT_NEAR(error.offset, 0.05, 1e-12);
  }
}

TEST(RelativePoseErrors, ZeroUnderAnySimilarityAndKnownForOneTurnedCamera) {
  std::mt19937 random(7);
  const PoseMap truth = RandomPoses(5, random);
  const Sim3 truth_from_estimate{3, RandomRotation(random), RandomVector(random)};
  PoseMap estimate;
  for (const auto& [name, pose] : truth) estimate[name] = InEstimateFrame(pose, truth_from_estimate);
  for (const double error : RelativePoseErrorsDeg(estimate, truth)) EXPECT_LT(error, 1e-10);
  ASSERT_EQ(RelativePoseErrorsDeg(estimate, truth).size(), 10u);

  // A camera turned in place turns its four relative poses by as much, and their translations by no more.
  estimate["a2.jpg"] = TurnedInPlace(estimate["a2.jpg"], 4, RandomVector(random));
  int num_turned = 0;
  for (const double error : RelativePoseErrorsDeg(estimate, truth)) {
    EXPECT_TRUE(error < 1e-10 || std::abs(error - 4) < 1e-10) << error;
    num_turned += error > 1;
  }
  EXPECT_EQ(num_turned, 4);

  estimate.erase("a0.jpg");
  const std::vector<double> errors = RelativePoseErrorsDeg(estimate, truth);
  EXPECT_EQ(std::count(errors.begin(), errors.end(), 180.0), 4);
}

TEST(RelativePoseErrors, WithoutBaselineOnlyTheRotationCounts) {
  const Rigid3 pose = LookFrom({1, 2, 3}, Quaterniond::Identity());
  const PoseMap truth = {{"a", pose}, {"b", pose}};
  const PoseMap estimate = {{"a", pose}, {"b", LookFrom({1, 2, 3.001}, Quaterniond::Identity())}};
  EXPECT_NEAR(RelativePoseErrorsDeg(estimate, truth, 1e-6).at(0), 0, 1e-12);
}

TEST(AreaUnderRecall, ClosedForms) {
  EXPECT_DOUBLE_EQ(AreaUnderRecall({0, 0, 0}, 5), 1);
  EXPECT_DOUBLE_EQ(AreaUnderRecall({}, 5), 0);
  EXPECT_DOUBLE_EQ(AreaUnderRecall({5, 180}, 5), 0);
  // One error e: the curve rises to 1 at e and stays: 1 - e / (2 t).
  EXPECT_DOUBLE_EQ(AreaUnderRecall({2}, 5), 1 - 2.0 / 10);
  // Of two, one fails: half of that.
  EXPECT_DOUBLE_EQ(AreaUnderRecall({180, 2}, 5), (1 - 2.0 / 10) / 2);
  // 1 and 3 of 10: 1 * 0.5 / 2 + 2 * (0.5 + 1) / 2 + 7 * 1.
  EXPECT_DOUBLE_EQ(AreaUnderRecall({3, 1}, 10), (0.25 + 1.5 + 7) / 10);
}

}  // namespace
}  // namespace s2gs
