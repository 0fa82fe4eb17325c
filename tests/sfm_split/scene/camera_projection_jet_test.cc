#include <ceres/jet.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "sfm_split/scene/camera_projection.h"

namespace s2gs {
namespace {

using Id = CameraModelId;

struct LensCase {
  Id model;
  std::vector<double> params;
};

const std::vector<LensCase>& Lenses() {
  static const std::vector<LensCase> lenses = {
      {Id::kSimplePinhole, {1.1, 0.5, 0.4}},
      {Id::kPinhole, {1.1, 1.2, 0.5, 0.4}},
      {Id::kSimpleRadial, {1.1, 0.5, 0.4, -0.11}},
      {Id::kRadial, {1.1, 0.5, 0.4, -0.11, 0.037}},
      {Id::kOpenCV, {1.1, 1.2, 0.5, 0.4, -0.11, 0.037, 0.013, -0.021}},
      {Id::kOpenCVFisheye, {0.7, 0.8, 0.5, 0.4, -0.021, 0.0037, -0.0013, 0.0002}},
      {Id::kFullOpenCV, {1.1, 1.2, 0.5, 0.4, -0.11, 0.037, 0.013, -0.021, 0.004, 0.05, -0.012, 0.003}},
  };
  return lenses;
}

// 12 parameters and 3 coordinates; unused parameters have zero derivatives.
constexpr int kNumVariables = 15;
using Jet = ceres::Jet<double, kNumVariables>;

void ExpectDerivativesMatchDifferences(const LensCase& lens, const Eigen::Vector3d& point) {
  std::vector<double> values(lens.params);
  values.resize(12, 0.0);
  values.insert(values.end(), point.data(), point.data() + 3);
  std::vector<Jet> jets;
  for (int i = 0; i < kNumVariables; ++i) jets.emplace_back(values[i], i);
  Jet xy[2];
  ASSERT_TRUE(ProjectPoint(lens.model, jets.data(), jets.data() + 12, xy));

  for (int i = 0; i < kNumVariables; ++i) {
    const double step = 1e-5 * std::max(0.1, std::abs(values[i]));
    Eigen::Vector2d ends[2];
    for (int side = 0; side < 2; ++side) {
      std::vector<double> moved = values;
      moved[i] += side == 0 ? -step : step;
      ASSERT_TRUE(ProjectPoint(lens.model, moved.data(), moved.data() + 12, ends[side].data()));
    }
    const Eigen::Vector2d difference = (ends[1] - ends[0]) / (2 * step);
    for (int row = 0; row < 2; ++row) {
      // Measured: at most 5.6e-10, the error of the difference.
      EXPECT_NEAR(xy[row].v[i], difference[row], 1e-8 * std::max(1.0, std::abs(difference[row])))
          << InfoOf(lens.model).name << ", variable " << i << ", point " << point.transpose();
    }
  }
}

TEST(CameraProjectionJet, DerivativesMatchDifferences) {
  const std::vector<Eigen::Vector3d> points = {{0.31, -0.22, 1.3}, {-1.1, 0.7, 2.4}, {0, 0.4, 1},
                                               {2, 1, 1.5},        {3e-3, 1e-3, 1},  {4e-3, 1e-3, 1}};
  for (const LensCase& lens : Lenses()) {
    for (const Eigen::Vector3d& point : points) ExpectDerivativesMatchDifferences(lens, point);
  }
}

TEST(CameraProjectionJet, DerivativesAreFiniteOnTheAxis) {
  for (const LensCase& lens : Lenses()) {
    std::vector<double> values(lens.params);
    values.resize(12, 0.0);
    values.insert(values.end(), {0, 0, 2});
    std::vector<Jet> jets;
    for (int i = 0; i < kNumVariables; ++i) jets.emplace_back(values[i], i);
    Jet xy[2];
    ASSERT_TRUE(ProjectPoint(lens.model, jets.data(), jets.data() + 12, xy));
    EXPECT_TRUE(xy[0].v.allFinite() && xy[1].v.allFinite()) << InfoOf(lens.model).name;
    EXPECT_NEAR(xy[0].v[12], lens.params[0] / 2, 1e-15);  // d(f x / z) / dx
    EXPECT_NEAR(xy[1].v[12], 0, 1e-15);
  }
}

}  // namespace
}  // namespace s2gs
