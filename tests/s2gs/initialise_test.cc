#include "s2gs/initialise.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

namespace s2gs {
namespace {

// A grid of 4 x 4 x 4 points, .1 apart: each has three nearest others at .1.
void AddGrid(const Eigen::Vector3d& corner, bool rotates, TrainingScene* scene) {
  for (int i = 0; i < 64; ++i) {
    const Eigen::Vector3d x = corner + 0.1 * Eigen::Vector3d(i % 4, i / 4 % 4, i / 16);
    scene->points.push_back({x, {51, 102, 204}, rotates});
  }
}

Gaussians Initialise(const TrainingScene& scene, const InitialiseOptions& options, uint64_t seed = 1) {
  Reporter silent;
  return InitialiseGaussians(scene, options, seed, silent);
}

Eigen::Vector3d Centre(const Gaussians& gaussians, size_t i) {
  return Eigen::Map<const Eigen::Vector3f>(&gaussians.centre[3 * i]).cast<double>();
}

double Logit(double p) { return std::log(p / (1 - p)); }

TEST(Initialise, PointsOfTheModelsAreTakenAsTheyAre) {
  TrainingScene scene;
  scene.mode = TrainMode::kS2gs;
  AddGrid({0, 0, 0}, true, &scene);
  AddGrid({3, 3, 3}, false, &scene);
  InitialiseOptions options;
  options.min_points = 64;
  const Gaussians gaussians = Initialise(scene, options);
  ASSERT_EQ(gaussians.size(), 128U);
  for (size_t i = 0; i < 128; ++i) {
    EXPECT_EQ(Centre(gaussians, i), scene.points[i].x.cast<float>().cast<double>());
    EXPECT_NEAR(gaussians.log_scale[2 * i], std::log(0.1), 1e-5);  // of floats near 3
    EXPECT_EQ(gaussians.log_scale[2 * i], gaussians.log_scale[2 * i + 1]);
    EXPECT_NEAR(gaussians.opacity_logit[i], Logit(0.1), 1e-6);
    EXPECT_NEAR(gaussians.foreground_logit[i], i < 64 ? Logit(0.9) : -Logit(0.9), 1e-6);
    // The colour that a Gaussian shows is its first coefficient times the band's constant, and a half.
    const double red = 0.5 + 0.28209479177387814 * gaussians.sh_dc[3 * i];
    EXPECT_NEAR(red, 51 / 255.0, 1e-6);
    const Eigen::Map<const Eigen::Vector4f> q(&gaussians.rotation[4 * i]);
    EXPECT_NEAR(q.norm(), 1, 1e-6);
  }
}

// The mean of a uniform rotation's matrix is 0: each of its nine entries has a variance of a third.
TEST(Initialise, OrientationsAreUniform) {
  TrainingScene scene;
  scene.mode = TrainMode::kStatic;
  InitialiseOptions options;
  options.min_points = 20000;
  const Gaussians gaussians = Initialise(scene, options);
  Eigen::Matrix3d mean = Eigen::Matrix3d::Zero();
  Eigen::Matrix3d square = Eigen::Matrix3d::Zero();
  const auto count = static_cast<double>(gaussians.size());
  for (size_t i = 0; i < gaussians.size(); ++i) {
    const float* q = &gaussians.rotation[4 * i];
    const Eigen::Matrix3d r = Eigen::Quaterniond(q[0], q[1], q[2], q[3]).toRotationMatrix();
    mean += r / count;
    square += r.cwiseProduct(r) / count;
  }
  const double sigma = std::sqrt(1 / (3 * count));
  EXPECT_LT(mean.cwiseAbs().maxCoeff(), 4 * sigma);
  EXPECT_LT((square.array() - 1 / 3.0).abs().maxCoeff(), 4 * sigma);
}

// Where nothing turns, the missing points are random: half in a cube, half on a sphere about it.
TEST(Initialise, AStaticSceneIsFilledUpWithACubeAndASphere) {
  for (const size_t points : {0, 64}) {
    TrainingScene scene;
    scene.mode = TrainMode::kStatic;
    if (points > 0) AddGrid({0, 0, 0}, false, &scene);
    InitialiseOptions options;
    options.min_points = 1001;
    const Gaussians gaussians = Initialise(scene, options);
    ASSERT_EQ(gaussians.size(), 1001U);
    size_t on_sphere = 0;
    double radius = 0;
    for (size_t i = 0; i < gaussians.size(); ++i) radius = std::max(radius, Centre(gaussians, i).norm());
    EXPECT_NEAR(radius, 4 * 0.5,
                1e-5);  // without a rotating part its cube has sides of half the scene's size
    for (size_t i = points; i < gaussians.size(); ++i) {
      on_sphere += std::abs(Centre(gaussians, i).norm() - radius) < 1e-5 * radius ? 1 : 0;
      if (std::abs(Centre(gaussians, i).norm() - radius) < 1e-5 * radius) continue;
      // The sphere's radius is 4 sides of the rotating part's cube, and this cube has two of them.
      EXPECT_LE(Centre(gaussians, i).lpNorm<Eigen::Infinity>(), radius / 4 * (1 + 1e-5));
    }
    EXPECT_EQ(on_sphere, (1001 - points) - (1001 - points) / 2);
  }
}

TEST(Initialise, EachBodyIsFilledUpAndTheUserHearsOfNoPoints) {
  TrainingScene scene;
  scene.mode = TrainMode::kS2gs;
  AddGrid({0, 0, 0}, false, &scene);
  InitialiseOptions options;
  options.min_points = 100;
  const Gaussians gaussians = Initialise(scene, options);
  ASSERT_EQ(gaussians.size(), 64U + 100U + 36U);
  for (size_t i = 64; i < 164; ++i) EXPECT_NEAR(gaussians.foreground_logit[i], 0, 1e-6);
  for (size_t i = 164; i < 200; ++i) EXPECT_NEAR(gaussians.foreground_logit[i], -Logit(0.9), 1e-6);
}

TEST(Initialise, OfALargeModelEveryNthPointIsTaken) {
  TrainingScene scene;
  scene.mode = TrainMode::kS2gs;
  AddGrid({0, 0, 0}, true, &scene);
  AddGrid({3, 3, 3}, false, &scene);
  InitialiseOptions options;
  options.min_points = 1;
  options.max_points = 43;  // every third of 128
  const Gaussians gaussians = Initialise(scene, options);
  ASSERT_EQ(gaussians.size(), 43U);
  EXPECT_EQ(Centre(gaussians, 1), scene.points[3].x.cast<float>().cast<double>());
}

TEST(Initialise, TheSeedAloneDecides) {
  TrainingScene scene;
  scene.mode = TrainMode::kS2gs;
  InitialiseOptions options;
  options.init = InitialPoints::kRandom;
  options.num_random_points = 301;
  const Gaussians a = Initialise(scene, options, 7);
  EXPECT_EQ(a.size(), 301U);
  EXPECT_EQ(a.centre, Initialise(scene, options, 7).centre);
  EXPECT_NE(a.centre, Initialise(scene, options, 8).centre);
}

TEST(InitialiseOptions, CheckNamesTheFault) {
  EXPECT_FALSE(InitialiseOptions().Check());
  const auto fault = [](auto change) {
    InitialiseOptions options;
    change(options);
    const OptionCheck check = options.Check();
    return check ? check->field : "";
  };
  EXPECT_EQ(fault([](auto& o) { o.num_random_points = 0; }), "num_random_points");
  EXPECT_EQ(fault([](auto& o) { o.num_random_points = 1; }), "");
  EXPECT_EQ(fault([](auto& o) { o.min_points = 0; }), "min_points");
  EXPECT_EQ(fault([](auto& o) { o.max_points = 0; }), "max_points");
  EXPECT_EQ(fault([](auto& o) { o.opacity = 0; }), "opacity");
  EXPECT_EQ(fault([](auto& o) { o.opacity = 1; }), "opacity");
  EXPECT_EQ(fault([](auto& o) { o.random_foreground = 1; }), "random_foreground");
  EXPECT_EQ(fault([](auto& o) { o.sparse_foreground = 0.49; }), "sparse_foreground");
  EXPECT_EQ(fault([](auto& o) { o.sparse_foreground = 0.5; }), "");
  EXPECT_EQ(fault([](auto& o) { o.background_radius_sides = 0; }), "background_radius_sides");
}

}  // namespace
}  // namespace s2gs
