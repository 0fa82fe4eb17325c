#include "sfm_split/circular_motion/circular_triples.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <array>
#include <cmath>
#include <limits>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"

namespace s2gs {
namespace {

constexpr std::array<int, 3> kPhotos = {0, 1, 2};

struct Setting {
  CircularLens lens{std::log(600.0), -0.1};
  CircularTurn turn;
};

// A camera 20 degrees above the table, rolled a little, and two different steps.
Setting Truth() {
  Setting setting;
  const double e = 20 * kDegree;
  const Eigen::Matrix3d roll = Eigen::AngleAxisd(0.1, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  const Eigen::Vector3d axis = roll * Eigen::Vector3d(0, -std::cos(e), -std::sin(e));
  const Eigen::Vector3d foot = roll * Eigen::Vector3d(0, -std::sin(e), std::cos(e));
  setting.turn.frame << foot, axis.cross(foot), axis;
  setting.turn.angles = {0, 11 * kDegree, 26 * kDegree};
  return setting;
}

// A point of the object, from the axis' foot, as the three photos see it; written down apart from the
// program.
CircularTriple Seen(const Setting& setting, const Eigen::Vector3d& from_foot) {
  CircularTriple triple;
  const Eigen::Vector3d foot = setting.turn.frame.col(0);
  for (size_t k = 0; k < 3; ++k) {
    const Eigen::Vector3d x =
        foot + Eigen::AngleAxisd(setting.turn.angles[k], setting.turn.frame.col(2)) * from_foot;
    const Eigen::Vector2d u = x.hnormalized();
    triple.xy[k] = std::exp(setting.lens.log_focal) * (1 + setting.lens.distortion * u.squaredNorm()) * u;
  }
  return triple;
}

const std::array<Eigen::Vector3d, 3> kPoints = {
    Eigen::Vector3d(0.1, 0.05, -0.1), Eigen::Vector3d(-0.12, 0.1, 0.02), Eigen::Vector3d(0.03, -0.2, 0.15)};

TEST(TripleError, IsNoneOfWhatTheTurnShows) {
  const Setting truth = Truth();
  for (const Eigen::Vector3d& point : kPoints)
    EXPECT_NEAR(TripleError(Seen(truth, point), truth.lens, truth.turn, kPhotos, nullptr), 0, 1e-9);
}

TEST(TripleError, IsHowFarTheMiddleKeypointLiesBesideAlongTheMove) {
  const Setting truth = Truth();
  CircularTriple triple = Seen(truth, kPoints[0]);
  const Eigen::Vector2d along = (triple.xy[2] - triple.xy[0]).normalized();
  triple.xy[1] -= 3 * along + 5 * Eigen::Vector2d(-along.y(), along.x());
  EXPECT_NEAR(TripleError(triple, truth.lens, truth.turn, kPhotos, nullptr), 3, 1e-9);
}

// What two photos do not tell: as much of the step as the distance from the axis gives of it.
TEST(TripleError, TellsTheStep) {
  const Setting truth = Truth();
  const CircularTriple triple = Seen(truth, kPoints[1]);
  CircularTurn wider = truth.turn;
  for (double& angle : wider.angles) angle *= 1.2;
  EXPECT_GT(std::abs(TripleError(triple, truth.lens, wider, kPhotos, nullptr)), 0.5);
}

TEST(TripleError, DerivativesAreThoseOfDifferences) {
  const Setting truth = Truth();
  Setting off = truth;  // where the error is not zero
  off.lens.log_focal += 0.1;
  off.turn.frame = ExpRotation<double>(Eigen::Vector3d(0.02, -0.03, 0.01)) * off.turn.frame;
  off.turn.angles[2] += 2 * kDegree;
  constexpr double kStep = 1e-6;
  for (const Eigen::Vector3d& point : kPoints) {
    const CircularTriple triple = Seen(truth, point);
    TripleDerivative derivative;
    const double error = TripleError(triple, off.lens, off.turn, kPhotos, &derivative);
    EXPECT_NEAR(error, TripleError(triple, off.lens, off.turn, kPhotos, nullptr), 1e-9);
    for (int k = 0; k < 7; ++k) {
      double at[2];
      for (const int side : {0, 1}) {
        const double by = side == 0 ? -kStep : kStep;
        Setting moved = off;
        if (k == 0) moved.lens.log_focal += by;
        if (k == 1) moved.lens.distortion += by;
        if (k >= 2 && k < 5)
          moved.turn.frame =
              ExpRotation<double>(Eigen::Vector3d(by * Eigen::Vector3d::Unit(k - 2))) * moved.turn.frame;
        if (k >= 5) moved.turn.angles[2] += by;
        if (k == 5) moved.turn.angles[1] += by;
        at[side] = TripleError(triple, moved.lens, moved.turn, kPhotos, nullptr);
      }
      const double expected = (at[1] - at[0]) / (2 * kStep);
      // Differences of a step of 1e-6 are good to 1e-6 of pixels per unit, of which there are hundreds.
      EXPECT_NEAR(derivative(k), expected, 1e-5 * std::max(1.0, std::abs(expected))) << k;
    }
  }
}

TEST(TripleError, IsInfiniteWhereTheRaysMeetBehind) {
  Setting truth = Truth();
  const CircularTriple triple = Seen(truth, kPoints[0]);
  truth.turn.frame.leftCols<2>() *= -1;
  EXPECT_EQ(TripleError(triple, truth.lens, truth.turn, kPhotos, nullptr),
            std::numeric_limits<double>::infinity());
}

// Farther from the axis than the cameras, and half a turn on.
TEST(TripleError, IsInfiniteWhereTheMiddlePhotoHasThePointBehindIt) {
  Setting truth = Truth();
  truth.turn.angles = {0, kPi, 20 * kDegree};
  const CircularTriple triple = Seen(truth, 1.5 * truth.turn.frame.col(0));
  TripleDerivative derivative = TripleDerivative::Ones();
  for (TripleDerivative* asked : {static_cast<TripleDerivative*>(nullptr), &derivative}) {
    EXPECT_EQ(TripleError(triple, truth.lens, truth.turn, kPhotos, asked),
              std::numeric_limits<double>::infinity());
  }
  EXPECT_TRUE(derivative.isZero(0));
  truth.turn.angles[1] = 10 * kDegree;
  const CircularTriple before = Seen(truth, 1.5 * truth.turn.frame.col(0));
  EXPECT_NEAR(TripleError(before, truth.lens, truth.turn, kPhotos, nullptr), 0, 1e-9);
}

}  // namespace
}  // namespace s2gs
