#include "sfm_split/scene/projection_jacobians.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "sfm_split/scene/camera_projection.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using Id = CameraModelId;
using Matrix23 = Eigen::Matrix<double, 2, 3>;
using Matrix2X = IntrinsicsJacobian;

struct Lens {
  Id model;
  std::vector<double> params;
};

std::vector<Lens> Lenses() {
  return {{Id::kSimplePinhole, {1.1, 0.5, 0.4}},
          {Id::kPinhole, {1.1, 1.2, 0.5, 0.4}},
          {Id::kSimpleRadial, {1.1, 0.5, 0.4, -0.11}},
          {Id::kRadial, {1.1, 0.5, 0.4, -0.11, 0.037}},
          {Id::kOpenCV, {1.1, 1.2, 0.5, 0.4, -0.11, 0.037, 0.013, -0.021}},
          {Id::kOpenCVFisheye, {0.7, 0.8, 0.5, 0.4, -0.021, 0.0037, -0.0013, 0.0002}},
          {Id::kFullOpenCV, {1.1, 1.2, 0.5, 0.4, -0.11, 0.037, 0.013, -0.021, 0.004, 0.05, -0.012, 0.003}}};
}

Vector2d Projected(const Lens& lens, const Vector3d& x) {
  Vector2d xy;
  EXPECT_TRUE(ProjectPoint(lens.model, lens.params.data(), x.data(), xy.data()));
  return xy;
}

// Central differences of the projection without derivatives. Their error is the third derivative (below 100
// here) times the step's square over 6, and rounding over the step: 2e-9 and 2e-11.
TEST(ProjectionJacobians, MatchDifferences) {
  constexpr double kStep = 1e-5;
  for (const Lens& lens : Lenses()) {
    for (const Vector3d& x : {Vector3d(0.31, -0.22, 1.3), Vector3d(-1.1, 0.7, 2.4), Vector3d(0, 0.4, 1)}) {
      Vector2d xy;
      Matrix23 by_x;
      Matrix2X by_params;
      ASSERT_TRUE(ProjectWithJacobians(lens.model, lens.params.data(), x, &xy, &by_x, &by_params));
      EXPECT_LT((xy - Projected(lens, x)).norm(), 1e-14);
      for (int i = 0; i < 3; ++i) {
        const Vector3d aside = kStep * Vector3d::Unit(i);
        const Vector2d slope = (Projected(lens, x + aside) - Projected(lens, x - aside)) / (2 * kStep);
        EXPECT_LT((by_x.col(i) - slope).norm(), 1e-8) << InfoOf(lens.model).name << ", coordinate " << i;
      }
      ASSERT_EQ(by_params.cols(), static_cast<Eigen::Index>(lens.params.size()));
      for (size_t i = 0; i < lens.params.size(); ++i) {
        Lens more = lens, less = lens;
        more.params[i] += kStep;
        less.params[i] -= kStep;
        const Vector2d slope = (Projected(more, x) - Projected(less, x)) / (2 * kStep);
        EXPECT_LT((by_params.col(static_cast<Eigen::Index>(i)) - slope).norm(), 1e-8)
            << InfoOf(lens.model).name << ", parameter " << i;
      }
    }
  }
}

TEST(ProjectionJacobians, BehindTheCameraPlaneIsRefused) {
  for (const Lens& lens : Lenses()) {
    Vector2d xy;
    for (const Vector3d& x : {Vector3d(0.1, 0.2, -1), Vector3d(0.1, 0.2, 0), Vector3d(0, 0, 0),
                              Vector3d(1, 0, 0.9e-6), Vector3d(1e6, 0, 0.9), Vector3d(0, 0, std::nan(""))}) {
      EXPECT_FALSE(ProjectWithJacobians(lens.model, lens.params.data(), x, &xy, nullptr, nullptr))
          << InfoOf(lens.model).name << ", " << x.transpose();
    }
  }
  const Lens pinhole = Lenses()[1];
  Vector2d xy;
  EXPECT_TRUE(
      ProjectWithJacobians(pinhole.model, pinhole.params.data(), {1, 0, 1.1e-6}, &xy, nullptr, nullptr));
}

TEST(ProjectionJacobians, EitherMayBeLeftOut) {
  const Vector3d x(0.31, -0.22, 1.3);
  for (const Lens& lens : Lenses()) {
    Vector2d xy, alone;
    Matrix23 by_x, by_x_alone;
    Matrix2X by_params, by_params_alone;
    ASSERT_TRUE(ProjectWithJacobians(lens.model, lens.params.data(), x, &xy, &by_x, &by_params));
    ASSERT_TRUE(ProjectWithJacobians(lens.model, lens.params.data(), x, &alone, &by_x_alone, nullptr));
    EXPECT_EQ(xy, alone);
    ASSERT_TRUE(ProjectWithJacobians(lens.model, lens.params.data(), x, &alone, nullptr, &by_params_alone));
    EXPECT_EQ(xy, alone);
    EXPECT_EQ(by_x, by_x_alone);
    EXPECT_EQ(by_params, by_params_alone);
  }
}

}  // namespace
}  // namespace s2gs
