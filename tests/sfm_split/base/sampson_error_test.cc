#include "sfm_split/base/sampson_error.h"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cmath>

#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using Eigen::Vector4d;

// The distance of (x1, x2) from the nearest pair with x2^T F x1 = 0, by Lagrange's condition, iterated.
double DistanceFromEpipolarPairs(const Matrix3d& F, const Vector3d& x1, const Vector3d& x2) {
  const Vector4d start(x1.x(), x1.y(), x2.x(), x2.y());
  Vector4d at = start;
  for (int iteration = 0; iteration < 50; ++iteration) {
    const Vector3d a(at[0], at[1], 1);
    const Vector3d b(at[2], at[3], 1);
    const Vector3d by_a = F.transpose() * b;
    const Vector3d by_b = F * a;
    const Vector4d gradient(by_a.x(), by_a.y(), by_b.x(), by_b.y());
    // The nearest point of the plane that touches the pairs here.
    const double value = b.dot(F * a) + gradient.dot(start - at);
    at = start - value / gradient.squaredNorm() * gradient;
  }
  return (at - start).norm();
}

TEST(SampsonError, IsTheDistanceFromTheNearestPairToFirstOrder) {
  RandomNumbers random(3);
  const auto uniform = [&] { return random.Uniform(-1, 1); };
  for (int run = 0; run < 200; ++run) {
    Matrix3d F;
    for (int i = 0; i < 9; ++i) F(i / 3, i % 3) = uniform();
    const Vector3d x1(uniform(), uniform(), 1);
    const Vector3d line2 = F * x1;
    if (line2.head<2>().norm() < 0.3) continue;
    // On its line, then 1e-4 beside it.
    const Eigen::Vector2d normal = line2.head<2>().normalized();
    const Eigen::Vector2d along(-normal.y(), normal.x());
    const Eigen::Vector2d on = -line2.z() / line2.head<2>().norm() * normal + uniform() * along;
    const double side = random.Uniform() < 0.5 ? -1 : 1;
    const Eigen::Vector2d beside = on + side * 1e-4 * normal;
    const Vector3d x2(beside.x(), beside.y(), 1);
    const double error = SampsonError<double>(F, x1, x2);
    EXPECT_GT(side * error, 0);
    // Second order: measured up to 3e-8 of 1e-4.
    EXPECT_NEAR(std::abs(error), DistanceFromEpipolarPairs(F, x1, x2), 2e-7);
    const Matrix3d scaled = 5 * F;
    EXPECT_NEAR(SampsonError<double>(scaled, x1, x2), error, 1e-15);
  }
}

TEST(SampsonError, WithoutLinesNothingAgrees) {
  const Matrix3d none = Matrix3d::Zero();
  EXPECT_GE(SampsonError<double>(none, Vector3d(1, 2, 1), Vector3d(3, 4, 1)), 1e6);
}

}  // namespace
}  // namespace s2gs
