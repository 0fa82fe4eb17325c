#include "sfm_split/base/rotation.h"

#include <ceres/jet.h>
#include <gtest/gtest.h>

#include <Eigen/LU>
#include <random>

#include "sfm_split/base/angles.h"
#include "tests/support/measured_bound.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using Jet = ceres::Jet<double, 3>;

const double kAngles[] = {0,          1e-300,     1e-160,     1e-20,       1e-9, 1e-5, 1e-3,
                          0.0999999,  0.1,        0.1001,     0.5,         1.5,  2.5,  3.1,
                          kPi - 1e-3, kPi - 1e-6, kPi - 1e-9, kPi - 1e-12, kPi};

std::vector<Vector3d> Directions() {
  std::vector<Vector3d> directions = {Vector3d::UnitX(),
                                      Vector3d::UnitY(),
                                      Vector3d::UnitZ(),
                                      -Vector3d::UnitX(),
                                      Vector3d(1, 1, 0).normalized(),
                                      Vector3d(1, 1, 1).normalized(),
                                      Vector3d(1, 1e-9, 0).normalized()};
  std::mt19937 rng(1);
  std::normal_distribution<double> normal;
  for (int i = 0; i < 20; ++i)
    directions.push_back(Vector3d(normal(rng), normal(rng), normal(rng)).normalized());
  return directions;
}

Eigen::Matrix<Jet, 3, 1> Seeded(const Vector3d& w) { return {Jet(w.x(), 0), Jet(w.y(), 1), Jet(w.z(), 2)}; }

TEST(Rotation, ExpEqualsEigensAngleAxis) {
  double worst = 0;
  for (const Vector3d& u : Directions()) {
    for (const double angle : kAngles) {
      const Matrix3d expected = Eigen::AngleAxisd(angle, u).toRotationMatrix();
      const Matrix3d r = ExpRotation<double>(angle * u);
      worst = std::max(worst, (r - expected).cwiseAbs().maxCoeff());
      EXPECT_LT((r * r.transpose() - Matrix3d::Identity()).norm(), 1e-14);
      EXPECT_LT((RotationAbout<double>(u, angle) - expected).cwiseAbs().maxCoeff(), 1e-14);
    }
  }
  ExpectWithin(numerics::kGeometry, "exp of rotation vectors, 0 to pi, against Eigen's", "double", worst,
               1e-14);
}

TEST(Rotation, LogInvertsExpFromZeroToPi) {
  double worst = 0;
  for (const Vector3d& u : Directions()) {
    for (const double angle : kAngles) {
      const Vector3d w = LogRotation<double>(ExpRotation<double>(angle * u));
      // At pi the sign is free.
      const double error = angle > kPi - 1e-7 ? std::min((w - angle * u).norm(), (w + angle * u).norm())
                                              : (w - angle * u).norm();
      worst = std::max(worst, error);
      if (angle > 0 && angle < 1e-3 && angle > 1e-150) {
        EXPECT_LT(error, 1e-12 * angle) << angle;  // relative: tiny angles keep their digits
      }
    }
  }
  ExpectWithin(numerics::kGeometry, "log after exp, 0 to pi", "double", worst, 1e-13);
}

TEST(Rotation, LogInvertsExpBeyondPiToTheShorterTurn) {
  const Vector3d u = Vector3d(1, 2, -2) / 3;
  EXPECT_LT((LogRotation<double>(ExpRotation<double>((kPi + 0.3) * u)) + (kPi - 0.3) * u).norm(), 1e-14);
}

TEST(Rotation, JacobiansOfExpAreFiniteAndEqualFiniteDifferences) {
  double worst = 0;
  for (const Vector3d& u : Directions()) {
    for (const double angle : kAngles) {
      const Vector3d w = angle * u;
      const Eigen::Matrix<Jet, 3, 3> r = ExpRotation<Jet>(Seeded(w));
      const Matrix3d left = LeftJacobian<double>(w);
      const Matrix3d value = ExpRotation<double>(w);
      for (int k = 0; k < 3; ++k) {
        Matrix3d derivative;
        for (int i = 0; i < 9; ++i) derivative(i) = r(i).v(k);
        ASSERT_TRUE(derivative.allFinite()) << angle;
        // d exp(w) = [J e_k]x exp(w)
        const Matrix3d expected = CrossMatrix<double>(left.col(k)) * value;
        worst = std::max(worst, (derivative - expected).cwiseAbs().maxCoeff());
        const double h = 1e-5;
        const Matrix3d difference = (ExpRotation<double>(w + h * Vector3d::Unit(k)) -
                                     ExpRotation<double>(w - h * Vector3d::Unit(k))) /
                                    (2 * h);
        EXPECT_LT((derivative - difference).cwiseAbs().maxCoeff(), 1e-9) << angle;  // measured 5e-11
      }
    }
  }
  ExpectWithin(numerics::kGeometry, "derivative of exp, 0 to pi, against its Jacobian", "double", worst,
               1e-9);
}

TEST(Rotation, JacobianOfLogIsFiniteAndTheInverseOfTheJacobianOfExp) {
  double worst = 0;
  for (const Vector3d& u : Directions()) {
    for (const double angle : kAngles) {
      // Near pi the log jumps between +u and -u: the Jet has to give the derivative of the branch it is on.
      const Matrix3d value = ExpRotation<double>(angle * u);
      const Vector3d w = LogRotation<double>(value);
      // exp(e) exp(w) with e the Jet's infinitesimal.
      const Eigen::Matrix<Jet, 3, 3> moved = ExpRotation<Jet>(Seeded(Vector3d::Zero())) * value.cast<Jet>();
      const Eigen::Matrix<Jet, 3, 1> log = LogRotation<Jet>(moved);
      Matrix3d derivative;
      for (int i = 0; i < 3; ++i) derivative.row(i) = log(i).v.transpose();
      ASSERT_TRUE(derivative.allFinite()) << angle;
      const Matrix3d inverse = LeftJacobian<double>(w).inverse();
      worst = std::max(worst, (derivative - inverse).cwiseAbs().maxCoeff());
    }
  }
  ExpectWithin(numerics::kGeometry, "derivative of log, 0 to pi, against its Jacobian", "double", worst,
               1e-9);
}

TEST(Rotation, SeriesAndClosedFormMeetWithoutAStep) {
  const Vector3d u = Vector3d(2, -1, 2) / 3;
  const double below = 0.1 * (1 - 1e-12);
  const double above = 0.1 * (1 + 1e-12);
  EXPECT_LT((LeftJacobian<double>(above * u) - LeftJacobian<double>(below * u)).norm(), 1e-12);
  EXPECT_LT((ExpRotation<double>(above * u) - ExpRotation<double>(below * u)).norm(), 1e-12);
}

TEST(Rotation, AngleAboutFindsTheClosestTurn) {
  const Vector3d u = Vector3d(2, -1, 2) / 3;
  for (double angle = -3.1; angle < 3.2; angle += 0.1) {
    EXPECT_NEAR(AngleAbout(u, RotationAbout<double>(u, angle)), angle, 1e-14);
  }
  const Matrix3d r = ExpRotation<double>(Vector3d(0.3, -0.5, 0.9));
  const double best = AngleAbout(u, r);
  const auto distance = [&](double a) { return (RotationAbout<double>(u, a) - r).norm(); };
  EXPECT_LT(distance(best), distance(best + 1e-4));
  EXPECT_LT(distance(best), distance(best - 1e-4));
}

TEST(Rotation, WrapAngleIsInHalfOpenInterval) {
  EXPECT_DOUBLE_EQ(WrapAngle(kPi), kPi);
  EXPECT_DOUBLE_EQ(WrapAngle(-kPi), kPi);
  EXPECT_NEAR(WrapAngle(7), 7 - 2 * kPi, 1e-15);
  EXPECT_EQ(WrapAngle(-0.25), -0.25);
}

TEST(Rotation, MeansRecoverTheCentreAndTheMedianIgnoresAMinority) {
  std::mt19937 rng(3);
  std::normal_distribution<double> normal;
  const auto vector = [&] { return Vector3d(normal(rng), normal(rng), normal(rng)); };
  const Eigen::Quaterniond centre(ExpRotation<double>(Vector3d(2.9, 0.4, -0.8)));
  std::vector<Eigen::Quaterniond> rotations;
  for (int i = 0; i < 40; ++i) {
    const Vector3d w = 1e-3 * vector();
    rotations.push_back(Eigen::Quaterniond(ExpRotation<double>(w)) * centre);
    rotations.push_back(Eigen::Quaterniond(ExpRotation<double>(-w)) * centre);
    rotations.back().coeffs() *= i % 2 == 0 ? -1 : 1;  // the sign of a quaternion means nothing
  }
  const double clean = AngleBetween(MedianRotation(rotations), centre);
  EXPECT_LT(clean, 1e-4);
  for (int i = 0; i < 24; ++i) rotations[i] = Eigen::Quaterniond(ExpRotation<double>(vector()));
  EXPECT_LT(AngleBetween(MedianRotation(rotations), centre), 1e-3);
}

}  // namespace
}  // namespace s2gs
