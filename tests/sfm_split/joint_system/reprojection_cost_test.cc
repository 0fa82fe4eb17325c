#include "sfm_split/joint_system/reprojection_cost.h"

#include <ceres/autodiff_cost_function.h>
#include <ceres/dynamic_autodiff_cost_function.h>
#include <gtest/gtest.h>

#include <random>

#include "sfm_split/base/rotation.h"
#include "sfm_split/scene/camera_projection.h"
#include "tests/support/measured_bound.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Kind = ReprojectionCost::Kind;

// The same error written down once more, for dual numbers.
struct JetCost {
  Kind kind;
  Camera camera;
  Vector2d xy;
  Matrix3d camera_r0;
  Matrix3d object_r0;

  template <typename T>
  bool operator()(T const* const* p, T* residual) const {
    using V = Eigen::Matrix<T, 3, 1>;
    using M = Eigen::Matrix<T, 3, 3>;
    const int intrinsics = kind == Kind::kBackground ? 1 : (kind == Kind::kTurntable ? 3 : 2);
    V x = Eigen::Map<const V>(p[intrinsics + 1]);
    if (kind == Kind::kTurntable) {
      V n(p[1][0], p[1][1], T(1));
      n.normalize();
      const V a(p[1][2], p[1][3], T(0));
      x = V(a + ExpRotation<T>(V(n * p[2][0])) * (x - a));
    } else if (kind == Kind::kFreeObject) {
      const V w = Eigen::Map<const V>(p[1]);
      x = V(ExpRotation<T>(w) * M(object_r0.cast<T>()) * x + Eigen::Map<const V>(p[1] + 3));
    }
    const V w = Eigen::Map<const V>(p[0]);
    const V centre = Eigen::Map<const V>(p[0] + 3);
    const V in_cam = ExpRotation<T>(w) * M(camera_r0.cast<T>()) * (x - centre);
    T projected[2];
    if (!ProjectPoint(camera.model, p[intrinsics], in_cam.data(), projected)) return false;
    residual[0] = projected[0] - T(xy.x());
    residual[1] = projected[1] - T(xy.y());
    return true;
  }
};

struct Setting {
  Camera camera;
  Matrix3d camera_r0, object_r0;
  std::vector<std::vector<double>> blocks;
  Vector2d xy;
};

Setting RandomSetting(Kind kind, CameraModelId model, double angle, uint32_t seed,
                      double focal_over_width = 1.2) {
  std::mt19937 rng(seed);
  std::normal_distribution<double> normal;
  const auto vector = [&] { return Vector3d(normal(rng), normal(rng), normal(rng)); };
  Setting s;
  s.camera.model = model;
  s.camera.width = 640;
  const CameraModelInfo& info = InfoOf(model);
  for (size_t k = 0; k < info.num_focal_params; ++k)
    s.camera.params.push_back(640 * focal_over_width + 3.0 * k);
  s.camera.params.push_back(315);
  s.camera.params.push_back(244);
  while (s.camera.params.size() < info.NumParams()) s.camera.params.push_back(0.02 * normal(rng));
  const Vector3d centre = 3 * vector().normalized();
  // Looks at the origin; the point is near it.
  const Vector3d z = -centre.normalized();
  const Vector3d x = z.unitOrthogonal();
  s.camera_r0 << x.transpose(), z.cross(x).transpose(), z.transpose();
  s.object_r0 = ExpRotation<double>(vector());
  const Vector3d w = 0.1 * vector();
  s.blocks.push_back({w.x(), w.y(), w.z(), centre.x(), centre.y(), centre.z()});
  if (kind == Kind::kTurntable) {
    s.blocks.push_back({0.1 * normal(rng), 0.1 * normal(rng), 0.1 * normal(rng), 0.1 * normal(rng)});
    s.blocks.push_back({angle});
  } else if (kind == Kind::kFreeObject) {
    const Vector3d v = angle * vector().normalized();
    s.blocks.push_back({v.x(), v.y(), v.z(), 0.1 * normal(rng), 0.1 * normal(rng), 0.1 * normal(rng)});
  }
  s.blocks.push_back(s.camera.params);
  const Vector3d point = 0.3 * vector();
  s.blocks.push_back({point.x(), point.y(), point.z()});
  s.xy = Vector2d(320, 240) + 50 * Vector2d(normal(rng), normal(rng));
  return s;
}

struct Evaluated {
  bool ok = false;
  Vector2d residual;
  std::vector<Eigen::MatrixXd> jacobians;
};

Evaluated Evaluate(const ceres::CostFunction& cost, const std::vector<std::vector<double>>& blocks) {
  Evaluated e;
  std::vector<const double*> parameters;
  std::vector<std::vector<double>> storage;
  std::vector<double*> jacobians;
  for (const auto& block : blocks) {
    parameters.push_back(block.data());
    storage.emplace_back(2 * block.size());
  }
  for (auto& s : storage) jacobians.push_back(s.data());
  e.ok = cost.Evaluate(parameters.data(), e.residual.data(), jacobians.data());
  for (size_t b = 0; b < blocks.size(); ++b) {
    e.jacobians.push_back(Eigen::Map<Eigen::Matrix<double, 2, Eigen::Dynamic, Eigen::RowMajor>>(
        storage[b].data(), 2, static_cast<Eigen::Index>(blocks[b].size())));
  }
  return e;
}

TEST(ReprojectionCost, SpreadDividesErrorAndDerivatives) {
  for (const Kind kind : {Kind::kBackground, Kind::kTurntable, Kind::kFreeObject}) {
    const Setting s = RandomSetting(kind, CameraModelId::kSimpleRadial, 0.7, 4);
    const CeresReprojection plain(ReprojectionCost(kind, s.camera, s.xy, &s.camera_r0, &s.object_r0));
    const CeresReprojection spread(ReprojectionCost(kind, s.camera, s.xy, &s.camera_r0, &s.object_r0, 4));
    const Evaluated a = Evaluate(plain, s.blocks);
    const Evaluated b = Evaluate(spread, s.blocks);
    EXPECT_LT((a.residual - 4 * b.residual).norm(), 1e-12 * a.residual.norm());
    for (size_t k = 0; k < a.jacobians.size(); ++k) {
      EXPECT_GT(a.jacobians[k].norm(), 0);
      EXPECT_LT((a.jacobians[k] - 4 * b.jacobians[k]).norm(), 1e-12 * a.jacobians[k].norm());
    }
  }
}

TEST(ReprojectionCost, AnalyticDerivativesEqualJets) {
  double worst = 0;
  for (const Kind kind : {Kind::kBackground, Kind::kTurntable, Kind::kFreeObject}) {
    for (const CameraModelId model :
         {CameraModelId::kSimplePinhole, CameraModelId::kPinhole, CameraModelId::kSimpleRadial,
          CameraModelId::kRadial, CameraModelId::kOpenCV, CameraModelId::kOpenCVFisheye,
          CameraModelId::kFullOpenCV}) {
      for (const double angle : {0.0, 1e-200, 1e-8, 0.3, 3.14159265358979, -2.0, 7.0}) {
        for (uint32_t seed = 0; seed < 10; ++seed) {
          for (const double focal : {0.3, 1.2, 10.0}) {
            const Setting s = RandomSetting(kind, model, angle, seed, focal);
            const CeresReprojection cost(ReprojectionCost(kind, s.camera, s.xy, &s.camera_r0, &s.object_r0));
            ceres::DynamicAutoDiffCostFunction<JetCost, 4> jets(
                new JetCost{kind, s.camera, s.xy, s.camera_r0, s.object_r0});
            for (const int size : cost.parameter_block_sizes()) jets.AddParameterBlock(size);
            jets.SetNumResiduals(2);
            const Evaluated a = Evaluate(cost, s.blocks);
            const Evaluated b = Evaluate(jets, s.blocks);
            ASSERT_TRUE(a.ok && b.ok);
            worst = std::max(worst, (a.residual - b.residual).norm() / (1 + b.residual.norm()));
            for (size_t k = 0; k < a.jacobians.size(); ++k) {
              ASSERT_TRUE(a.jacobians[k].allFinite());
              worst = std::max(worst, (a.jacobians[k] - b.jacobians[k]).norm() / (1 + b.jacobians[k].norm()));
            }
          }
        }
      }
    }
  }
  ExpectWithin(numerics::kGeometry,
               "residuals and derivatives against Jets, relative, focal length .3 to 10 x width, angles to 7",
               "double", worst, 1e-9);
}

TEST(ReprojectionCost, AnalyticDerivativesEqualFiniteDifferences) {
  for (const Kind kind : {Kind::kBackground, Kind::kTurntable, Kind::kFreeObject}) {
    for (uint32_t seed = 0; seed < 5; ++seed) {
      Setting s = RandomSetting(kind, CameraModelId::kSimpleRadial, 1.1, seed);
      const CeresReprojection cost(ReprojectionCost(kind, s.camera, s.xy, &s.camera_r0, &s.object_r0));
      const Evaluated at = Evaluate(cost, s.blocks);
      for (size_t block = 0; block < s.blocks.size(); ++block) {
        for (size_t k = 0; k < s.blocks[block].size(); ++k) {
          double& value = s.blocks[block][k];
          const double kept = value;
          const double h = 1e-6 * std::max(1.0, std::abs(kept));
          value = kept + h;
          const Vector2d above = Evaluate(cost, s.blocks).residual;
          value = kept - h;
          const Vector2d below = Evaluate(cost, s.blocks).residual;
          value = kept;
          const Vector2d expected = (above - below) / (2 * h);
          const Vector2d got = at.jacobians[block].col(static_cast<Eigen::Index>(k));
          EXPECT_LT((expected - got).norm(), 1e-6 * (1 + expected.norm()))
              << block << " " << k;  // measured 2e-8
        }
      }
    }
  }
}

TEST(ReprojectionCost, PointsAtAndBehindTheCameraAreFiniteAndWithoutDerivative) {
  Setting s = RandomSetting(Kind::kBackground, CameraModelId::kPinhole, 0, 1);
  const CeresReprojection cost(ReprojectionCost(Kind::kBackground, s.camera, s.xy, &s.camera_r0, nullptr));
  for (const double along : {1.0, 1.5, 3.0}) {  // at the centre, behind, far behind
    for (int k = 0; k < 3; ++k) s.blocks[2][k] = along * s.blocks[0][3 + k];
    const Evaluated e = Evaluate(cost, s.blocks);
    EXPECT_TRUE(e.ok);
    EXPECT_TRUE(e.residual.allFinite());
    for (const Eigen::MatrixXd& jacobian : e.jacobians) EXPECT_EQ(jacobian.norm(), 0);
  }
  s.blocks[2][0] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_TRUE(Evaluate(cost, s.blocks).residual.allFinite());
}

}  // namespace
}  // namespace s2gs
