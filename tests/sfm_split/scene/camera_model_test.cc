#include "sfm_split/scene/camera_model.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <random>
#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/scene/camera_projection.h"
#include "tests/support/bad_input.h"

namespace s2gs {
namespace {

using Id = CameraModelId;

Camera MakeCamera(Id model, std::vector<double> params) { return {7, model, 800, 600, std::move(params)}; }

// What pycolmap 4.2.1 reports for each of its models: id, name, parameter names, index of the first focal,
// principal point and extra parameter.
TEST(CameraModel, TableMatchesColmap) {
  struct Row {
    int id;
    const char* name;
    const char* params;
    size_t num_focal, num_pp, num_extra;
  };
  const std::vector<Row> rows = {
      {0, "SIMPLE_PINHOLE", "f, cx, cy", 1, 2, 0},
      {1, "PINHOLE", "fx, fy, cx, cy", 2, 2, 0},
      {2, "SIMPLE_RADIAL", "f, cx, cy, k", 1, 2, 1},
      {8, "SIMPLE_RADIAL_FISHEYE", "f, cx, cy, k", 1, 2, 1},
      {3, "RADIAL", "f, cx, cy, k1, k2", 1, 2, 2},
      {9, "RADIAL_FISHEYE", "f, cx, cy, k1, k2", 1, 2, 2},
      {4, "OPENCV", "fx, fy, cx, cy, k1, k2, p1, p2", 2, 2, 4},
      {5, "OPENCV_FISHEYE", "fx, fy, cx, cy, k1, k2, k3, k4", 2, 2, 4},
      {6, "FULL_OPENCV", "fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6", 2, 2, 8},
      {7, "FOV", "fx, fy, cx, cy, omega", 2, 2, 1},
      {10, "THIN_PRISM_FISHEYE", "fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, sx1, sy1", 2, 2, 8},
      {11, "RAD_TAN_THIN_PRISM_FISHEYE", "fx, fy, cx, cy, k0, k1, k2, k3, k4, k5, p0, p1, s0, s1, s2, s3", 2,
       2, 12},
      {12, "SIMPLE_DIVISION", "f, cx, cy, k", 1, 2, 1},
      {13, "DIVISION", "fx, fy, cx, cy, k", 2, 2, 1},
      {14, "SIMPLE_FISHEYE", "f, cx, cy", 1, 2, 0},
      {15, "FISHEYE", "fx, fy, cx, cy", 2, 2, 0},
      {16, "EUCM", "fx, fy, cx, cy, alpha, beta", 2, 2, 2},
      {17, "EQUIRECTANGULAR", "w, h", 0, 0, 2},
  };
  for (const Row& row : rows) {
    SCOPED_TRACE(row.name);
    const CameraModelInfo* info = FindCameraModel(row.id);
    ASSERT_NE(info, nullptr);
    EXPECT_EQ(info, FindCameraModel(row.name));
    EXPECT_EQ(static_cast<int>(info->id), row.id);
    EXPECT_EQ(info->name, row.name);
    EXPECT_EQ(info->param_names, row.params);
    EXPECT_EQ(info->num_focal_params, row.num_focal);
    EXPECT_EQ(info->num_principal_point_params, row.num_pp);
    EXPECT_EQ(info->num_extra_params, row.num_extra);
    EXPECT_EQ(info->NumParams(), 1u + std::count(row.params, row.params + std::strlen(row.params), ','));
  }
  EXPECT_EQ(FindCameraModel(-1), nullptr);
  EXPECT_EQ(FindCameraModel(18), nullptr);
  EXPECT_EQ(FindCameraModel(std::numeric_limits<int>::min()), nullptr);
  EXPECT_EQ(FindCameraModel("pinhole"), nullptr);
}

struct Reference {
  Id model;
  std::vector<double> params;
  std::vector<Eigen::Vector2d> pixels;
};

const std::vector<Eigen::Vector3d>& ReferencePoints() {
  static const std::vector<Eigen::Vector3d> points = {
      {0, 0, 2}, {0.001, -0.0004, 1}, {0.31, -0.22, 1.3}, {-1.1, 0.7, 2.4}};
  return points;
}

// ReferencePoints() through pycolmap 4.2.1's Camera.img_from_cam.
const std::vector<Reference>& References() {
  static const std::vector<Reference> references = {
      {Id::kSimplePinhole,
       {810.5, 401.25, 299.5},
       {{401.25, 299.5},
        {402.06049999999999, 299.17579999999998},
        {594.52307692307693, 162.33846153846153},
        {29.770833333333314, 535.89583333333326}}},
      {Id::kPinhole,
       {810.5, 795.25, 401.25, 299.5},
       {{401.25, 299.5},
        {402.06049999999999, 299.18189999999998},
        {594.52307692307693, 164.91923076923075},
        {29.770833333333314, 531.44791666666663}}},
      {Id::kSimpleRadial,
       {810.5, 401.25, 299.5, -0.11},
       {{401.25, 299.5},
        {402.06049989658021, 299.17580004136789},
        {592.70528073509331, 163.62851044606285},
        {41.831007667824053, 528.22117693865744}}},
      {Id::kRadial,
       {810.5, 401.25, 299.5, -0.11, 0.037},
       {{401.25, 299.5},
        {402.06049989658027, 299.17580004136789},
        {592.75756070991338, 163.59140852844857},
        {40.6337460427618, 528.98307070006069}}},
      {Id::kOpenCV,
       {810.5, 795.25, 401.25, 299.5, -0.11, 0.037, 0.0013, -0.0021},
       {{401.25, 299.5},
        {402.06049367518222, 299.18190290667053},
        {592.33341982529805, 166.43100132872658},
        {39.134602466372826, 525.59273697462049}}},
      {Id::kOpenCVFisheye,
       {310.5, 305.25, 401.25, 299.5, -0.021, 0.0037, -0.0013, 0.0002},
       {{401.25, 299.5},
        {401.56049987237634, 299.37790005018633},
        {473.16336495666724, 249.32762429312774},
        {271.53567610215106, 380.64978234189101}}},
      {Id::kFullOpenCV,
       {810.5, 795.25, 401.25, 299.5, -0.11, 0.037, 0.0013, -0.0021, 0.004, 0.05, -0.012, 0.003},
       {{401.25, 299.5},
        {402.06049362817328, 299.18190292512031},
        {591.53496653397951, 166.98698387865645},
        {44.001750145122685, 522.55373811413244}}},
  };
  return references;
}

TEST(CameraProjection, MatchesColmap) {
  for (const Reference& reference : References()) {
    SCOPED_TRACE(InfoOf(reference.model).name);
    const Camera camera = MakeCamera(reference.model, reference.params);
    for (size_t i = 0; i < ReferencePoints().size(); ++i) {
      const auto xy = ProjectToImage(camera, ReferencePoints()[i]);
      ASSERT_TRUE(xy);
      // Measured: at most 1.1e-13.
      EXPECT_LT((*xy - reference.pixels[i]).norm(), 1e-12) << i;
    }
  }
}

TEST(CameraProjection, FloatAgreesWithDouble) {
  for (const Reference& reference : References()) {
    SCOPED_TRACE(InfoOf(reference.model).name);
    const std::vector<float> params(reference.params.begin(), reference.params.end());
    for (size_t i = 0; i < ReferencePoints().size(); ++i) {
      const Eigen::Vector3f point = ReferencePoints()[i].cast<float>();
      Eigen::Vector2f xy;
      ASSERT_TRUE(ProjectPoint(reference.model, params.data(), point.data(), xy.data()));
      // Measured: at most 4.2e-5; half a unit in the last place of 594 is 3e-5.
      EXPECT_LT((xy.cast<double>() - reference.pixels[i]).norm(), 2e-4) << i;
    }
  }
}

// Lenses as strong as real ones, over focal lengths from 0.3 to 10 widths.
TEST(CameraProjection, UnprojectInvertsProject) {
  double worst_pixel = 0;
  double worst_ray = 0;
  int num_rays = 0;
  for (const Reference& reference : References()) {
    SCOPED_TRACE(InfoOf(reference.model).name);
    for (const double ratio : {0.3, 0.5, 1.0, 3.0, 10.0}) {
      Camera camera = MakeCamera(reference.model, reference.params);
      const size_t num_focal = InfoOf(reference.model).num_focal_params;
      for (size_t i = 0; i < num_focal; ++i) camera.params[i] = ratio * 800 * (1 + 0.02 * i);
      for (double y = 0; y <= 600; y += 37.5) {
        for (double x = 0; x <= 800; x += 40) {
          const auto ray = UnprojectFromImage(camera, {x, y});
          if (!ray) continue;  // Outside of the field of view; which those are is tested below.
          EXPECT_EQ(ray->z(), 1);
          const auto xy = ProjectToImage(camera, *ray);
          ASSERT_TRUE(xy) << ratio << " " << x << " " << y;
          worst_pixel = std::max(worst_pixel, (*xy - Eigen::Vector2d(x, y)).norm());
          const auto again = UnprojectFromImage(camera, *xy);
          ASSERT_TRUE(again);
          worst_ray = std::max(worst_ray, (*again - *ray).norm() / ray->squaredNorm());
          ++num_rays;
        }
      }
    }
  }
  EXPECT_GT(num_rays, 35 * 21 * 17 * 9 / 10);
  // Measured: 1.3e-13 px and 4.7e-16.
  EXPECT_LT(worst_pixel, 2e-12);
  EXPECT_LT(worst_ray, 1e-14);
}

TEST(CameraProjection, RandomLensesNeverGiveAWrongRay) {
  std::mt19937 random(1);
  std::uniform_real_distribution<double> uniform(-1, 1);
  const std::vector<Id> models = {Id::kSimpleRadial, Id::kRadial, Id::kOpenCV, Id::kOpenCVFisheye,
                                  Id::kFullOpenCV};
  int num_failed = 0;
  int num_rays = 0;
  for (int i = 0; i < 20000; ++i) {
    Camera camera = MakeCamera(models[i % models.size()], {});
    const CameraModelInfo& info = InfoOf(camera.model);
    const double focal = 800 * std::pow(10.0, 0.25 + 0.75 * uniform(random));
    camera.params.assign(info.NumParams(), focal);
    camera.params[info.num_focal_params] = 400;
    camera.params[info.num_focal_params + 1] = 300;
    for (size_t j = info.FirstExtraParam(); j < info.NumParams(); ++j) camera.params[j] = uniform(random);
    const bool tangential = camera.model == Id::kOpenCV || camera.model == Id::kFullOpenCV;
    if (tangential) camera.params[6] *= 0.01;
    if (tangential) camera.params[7] *= 0.01;

    // Every point that can be seen must be found again, never another one.
    const Eigen::Vector3d point(uniform(random), uniform(random), 1);
    const auto xy = ProjectToImage(camera, point);
    if (!xy) {
      ++num_failed;
      continue;
    }
    ++num_rays;
    const auto ray = UnprojectFromImage(camera, *xy);
    ASSERT_TRUE(ray) << i << " " << info.name;
    // Measured: at most 3.5e-13; closer to the turning point the inverse would lose up to half of the digits.
    EXPECT_LT((*ray - point).norm(), 1e-9) << i << " " << info.name;
  }
  EXPECT_GT(num_rays, 10000);
  EXPECT_GT(num_failed, 1000);
}

// r (1 + k r^2) with k = -0.3 turns back at r = 1 / sqrt(0.9), where it is 2/3 of that.
TEST(CameraProjection, PixelsAndRaysBeyondTheTurningPointAreRefused) {
  const Camera camera = MakeCamera(Id::kSimpleRadial, {100, 0, 0, -0.3});
  const double turn = 1 / std::sqrt(0.9);
  EXPECT_TRUE(ProjectToImage(camera, {turn * (1 - 1e-9), 0, 1}));
  EXPECT_FALSE(ProjectToImage(camera, {turn * (1 + 1e-9), 0, 1}));
  EXPECT_FALSE(ProjectToImage(camera, {1.5, 1.5, 1}));
  const double edge = 100 * turn * 2 / 3;
  EXPECT_FALSE(UnprojectFromImage(camera, {edge * (1 + 1e-6), 0}));
  EXPECT_FALSE(UnprojectFromImage(camera, {0, 1e6}));
  const auto ray = UnprojectFromImage(camera, {edge * (1 - 1e-6), 0});
  ASSERT_TRUE(ray);
  EXPECT_LT(ray->x(), turn);
  EXPECT_NEAR(ray->x() * (1 - 0.3 * ray->x() * ray->x()), edge * (1 - 1e-6) / 100, 1e-12);
}

// 1 - 2 s + 1.1 s^2 times r: falls between two turning points, then rises again past every pixel.
// Rational lenses, whose slope has degree six in r^2: a ray is projected exactly when no nearer one turns
// back, by the slope at a thousand places between.
TEST(CameraProjection, RationalLensesEndAtTheirFirstTurningPoint) {
  std::mt19937 random(11);
  std::uniform_real_distribution<double> unit(-1, 1);
  int refused = 0;
  int accepted = 0;
  for (int lens = 0; lens < 3000; ++lens) {
    std::vector<double> params = {500, 500, 400, 300, 0, 0, 0, 0, 0, 0, 0, 0};
    double k[6];
    for (int i = 0; i < 6; ++i) k[i] = 0.6 * unit(random);
    params[4] = k[0];
    params[5] = k[1];
    params[8] = k[2];
    for (int i = 0; i < 3; ++i) params[9 + i] = k[3 + i];
    const Camera camera = MakeCamera(Id::kFullOpenCV, params);
    const double r = 0.2 + 1.3 * std::abs(unit(random));
    // Of r N / D: (N + 2 s N') D - 2 s N D' over D^2, with s = r^2; and D itself.
    double least = 1;
    for (int i = 0; i <= 1000; ++i) {
      const double s = std::pow(r * i / 1000, 2);
      const double n = 1 + s * (k[0] + s * (k[1] + s * k[2]));
      const double dn = k[0] + s * (2 * k[1] + s * 3 * k[2]);
      const double d = 1 + s * (k[3] + s * (k[4] + s * k[5]));
      const double dd = k[3] + s * (2 * k[4] + s * 3 * k[5]);
      least = std::min({least, d, (n + 2 * s * dn) * d - 2 * s * n * dd});
    }
    if (std::abs(least) < 1e-3) continue;  // between two places it may still turn
    const bool is_seen = ProjectToImage(camera, {0.6 * r, 0.8 * r, 1}).has_value();
    EXPECT_EQ(is_seen, least > 0) << "lens " << lens << ": " << least;
    ++(is_seen ? accepted : refused);
  }
  EXPECT_GT(refused, 500);
  EXPECT_GT(accepted, 500);
}

TEST(CameraProjection, TheRisingBranchBehindTheTurningPointIsRefused) {
  const Camera camera = MakeCamera(Id::kRadial, {100, 0, 0, -2, 1.1});
  EXPECT_TRUE(ProjectToImage(camera, {0.3, 0, 1}));
  EXPECT_FALSE(ProjectToImage(camera, {2, 0, 1}));  // 100 * 2 * (1 - 8 + 17.6)
  EXPECT_FALSE(UnprojectFromImage(camera, {2120, 0}));
}

TEST(CameraProjection, ZeroOfTheDenominatorIsRefused) {
  const Camera camera = MakeCamera(Id::kFullOpenCV, {100, 100, 0, 0, 0, 0, 0, 0, 0, -1, 0, 0});
  EXPECT_TRUE(ProjectToImage(camera, {0.9, 0, 1}));
  EXPECT_FALSE(ProjectToImage(camera, {1, 0, 1}));
  EXPECT_FALSE(ProjectToImage(camera, {1.1, 0, 1}));
}

TEST(CameraProjection, FisheyeUpToTheCameraPlane) {
  const Camera camera = MakeCamera(Id::kOpenCVFisheye, {200, 200, 400, 300, 0, 0, 0, 0});
  for (const double degrees : {1e-9, 1e-3, 0.17, 0.19, 45.0, 89.0, 89.99}) {
    const double theta = degrees * kPi / 180;
    const auto xy = ProjectToImage(camera, {std::sin(theta), 0, std::cos(theta)});
    ASSERT_TRUE(xy);
    EXPECT_NEAR(xy->x(), 400 + 200 * theta, 1e-12 * 400) << degrees;  // r = f theta
    const auto ray = UnprojectFromImage(camera, *xy);
    ASSERT_TRUE(ray);
    EXPECT_NEAR(std::atan(ray->x()), theta, 1e-14) << degrees;
  }
  EXPECT_FALSE(UnprojectFromImage(camera, {400 + 200 * kPi / 2 * (1 + 1e-12), 300}));
  EXPECT_FALSE(ProjectToImage(camera, {1, 0, 0}));
  EXPECT_FALSE(ProjectToImage(camera, {1, 0, -1e-9}));
}

TEST(CameraProjection, NothingBehindTheCameraOrNotFinite) {
  const double inf = std::numeric_limits<double>::infinity();
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (const Reference& reference : References()) {
    SCOPED_TRACE(InfoOf(reference.model).name);
    const Camera camera = MakeCamera(reference.model, reference.params);
    for (const Eigen::Vector3d& point : std::vector<Eigen::Vector3d>{{0, 0, 0},
                                                                     {0, 0, -1},
                                                                     {1, 2, 0},
                                                                     {nan, 0, 1},
                                                                     {0, 0, nan},
                                                                     {inf, 0, 1},
                                                                     {1e300, 1e300, 1e-300}}) {
      EXPECT_FALSE(ProjectToImage(camera, point)) << point.transpose();
    }
    EXPECT_FALSE(UnprojectFromImage(camera, {nan, 0}));
    EXPECT_FALSE(UnprojectFromImage(camera, {0, inf}));
  }
}

TEST(CameraModel, OnlyPinholesAreDistortionFree) {
  EXPECT_TRUE(IsDistortionFree(MakeCamera(Id::kSimplePinhole, {1, 2, 3})));
  EXPECT_TRUE(IsDistortionFree(MakeCamera(Id::kPinhole, {1, 1, 2, 3})));
  EXPECT_TRUE(IsDistortionFree(MakeCamera(Id::kSimpleRadial, {1, 2, 3, 0})));
  EXPECT_FALSE(IsDistortionFree(MakeCamera(Id::kSimpleRadial, {1, 2, 3, -1e-4})));
  EXPECT_TRUE(IsDistortionFree(MakeCamera(Id::kOpenCV, {1, 1, 2, 3, 0, 0, 0, 0})));
  EXPECT_FALSE(IsDistortionFree(MakeCamera(Id::kOpenCV, {1, 1, 2, 3, 0, 0, 0, 1e-3})));
  EXPECT_FALSE(IsDistortionFree(MakeCamera(Id::kOpenCV, {1, 1, 2, 3, 0, 0, 0, std::nan("")})));
  EXPECT_TRUE(IsDistortionFree(MakeCamera(Id::kEucm, {1, 1, 2, 3, 0, 1})));
  EXPECT_FALSE(IsDistortionFree(MakeCamera(Id::kEucm, {1, 1, 2, 3, 0.5, 1})));
  for (const Id model :
       {Id::kOpenCVFisheye, Id::kSimpleRadialFisheye, Id::kRadialFisheye, Id::kThinPrismFisheye,
        Id::kRadTanThinPrismFisheye, Id::kSimpleFisheye, Id::kFisheye, Id::kEquirectangular}) {
    SCOPED_TRACE(InfoOf(model).name);
    Camera camera = MakeCamera(model, std::vector<double>(InfoOf(model).NumParams(), 0));
    std::fill_n(camera.params.begin(), InfoOf(model).num_focal_params, 500);
    EXPECT_FALSE(IsDistortionFree(camera));
  }
}

TEST(CameraModel, FocalLengthsAndPrincipalPoint) {
  EXPECT_EQ(FocalLengths(MakeCamera(Id::kSimpleRadial, {1, 2, 3, 4})), Eigen::Vector2d(1, 1));
  EXPECT_EQ(PrincipalPoint(MakeCamera(Id::kSimpleRadial, {1, 2, 3, 4})), Eigen::Vector2d(2, 3));
  EXPECT_EQ(FocalLengths(MakeCamera(Id::kPinhole, {1, 2, 3, 4})), Eigen::Vector2d(1, 2));
  EXPECT_EQ(PrincipalPoint(MakeCamera(Id::kPinhole, {1, 2, 3, 4})), Eigen::Vector2d(3, 4));
}

TEST(CameraModel, UnsupportedModelsSayWhatToDo) {
  const Camera camera = MakeCamera(Id::kFov, {1, 1, 2, 3, 0.9});
  ExpectUserError([&] { RequireProjection(camera, "w/cameras.bin"); },
                  {"w/cameras.bin", "camera 7", "FOV", "FULL_OPENCV", "image_undistorter"});
  ExpectUserError([&] { ProjectToImage(camera, {0, 0, 1}); }, {"FOV", "image_undistorter"});
  ExpectUserError([&] { UnprojectFromImage(camera, {0, 0}); }, {"FOV", "image_undistorter"});
  EXPECT_NO_THROW(RequireProjection(MakeCamera(Id::kPinhole, {1, 1, 2, 3}), "w/cameras.bin"));
}

}  // namespace
}  // namespace s2gs
