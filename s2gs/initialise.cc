#include "s2gs/initialise.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "s2gs/core/knn.h"
#include "s2gs/core/rng.h"
#include "s2gs/kernel/sh.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/number_text.h"

namespace s2gs {
namespace {

constexpr int kScaleNeighbours = 3;
constexpr float kMinDistance = 1e-7F;  // of duplicate points, in scene sizes squared, as 2DGS.
constexpr double kDefaultSide = 0.5;   // of the cube when no point says how large the rotating part is.

// Streams of random numbers.
enum Stream : uint64_t { kCubeStream = 101, kSphereStream = 102, kRotationStream = 103 };

struct Start {
  Eigen::Vector3d x;
  Eigen::Vector3d rgb = Eigen::Vector3d::Constant(0.5);
  double foreground = 0.5;
};

double Unit(const Random4& bits, int i) { return UnitDouble(bits.words[i]); }

double Logit(double p) {
  const double inside = std::clamp(p, 1e-6, 1 - 1e-6);
  return std::log(inside / (1 - inside));
}

// The cube that holds the rotating part, or in a static scene the points.
struct Cube {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  double side = kDefaultSide;
};

Cube FindCube(const TrainingScene& scene) {
  Cube cube;
  if (!scene.region) return cube;
  const RotatingRegion& region = *scene.region;
  cube.centre = region.axis.point + (region.low + region.high) / 2 * region.axis.direction;
  cube.side = std::max(2 * region.radius, region.high - region.low);
  return cube;
}

void AddCube(const Cube& cube, int64_t count, double foreground, uint64_t seed, std::vector<Start>* starts) {
  starts->reserve(starts->size() + count);
  for (int64_t i = 0; i < count; ++i) {
    const Random4 bits = RandomBits(seed, kCubeStream, i);
    const Eigen::Vector3d unit(Unit(bits, 0) - 0.5, Unit(bits, 1) - 0.5, Unit(bits, 2) - 0.5);
    starts->push_back({cube.centre + cube.side * unit, Eigen::Vector3d::Constant(0.5), foreground});
  }
}

void AddSphere(const Cube& cube, double radius, int64_t count, double foreground, uint64_t seed,
               std::vector<Start>* starts) {
  starts->reserve(starts->size() + count);
  for (int64_t i = 0; i < count; ++i) {
    const Random4 bits = RandomBits(seed, kSphereStream, i);
    const double z = 2 * Unit(bits, 0) - 1;
    const double angle = 2 * kPi * Unit(bits, 1);
    const double across = std::sqrt(std::max(0.0, 1 - z * z));
    const Eigen::Vector3d direction(across * std::cos(angle), across * std::sin(angle), z);
    starts->push_back({cube.centre + radius * direction, Eigen::Vector3d::Constant(0.5), foreground});
  }
}

void AddSparse(const TrainingScene& scene, const InitialiseOptions& options, std::vector<Start>* starts) {
  const auto total = static_cast<int64_t>(scene.points.size());
  const int64_t step = std::max<int64_t>(1, (total + options.max_points - 1) / options.max_points);
  starts->reserve(starts->size() + scene.points.size());
  for (int64_t i = 0; i < total; i += step) {
    const ScenePoint& point = scene.points[i];
    starts->push_back({point.x, point.rgb.cast<double>() / 255,
                       point.rotates ? options.sparse_foreground : 1 - options.sparse_foreground});
  }
}

std::vector<Start> ChooseStarts(const TrainingScene& scene, const InitialiseOptions& options, uint64_t seed,
                                Reporter& reporter) {
  const Cube cube = FindCube(scene);
  const double radius = options.background_radius_sides * cube.side;
  const SceneBodies bodies = scene.bodies();
  std::vector<Start> starts;
  if (options.init == InitialPoints::kRandom) {
    const bool only_cube = bodies == SceneBodies::kObjectOnly;
    const int64_t inside = only_cube ? options.num_random_points : options.num_random_points / 2;
    AddCube(cube, inside, options.random_foreground, seed, &starts);
    AddSphere(cube, radius, options.num_random_points - inside, options.random_foreground, seed, &starts);
    return starts;
  }
  int64_t rotating = 0;
  int64_t fixed = 0;
  for (const ScenePoint& point : scene.points) ++(point.rotates ? rotating : fixed);
  // In mode masks nothing else is wanted of a background.
  AddSparse(scene, options, &starts);
  if (bodies != SceneBodies::kStaticOnly && rotating < options.min_points) {
    AddCube(cube, options.min_points - rotating, options.random_foreground, seed, &starts);
  }
  if (bodies == SceneBodies::kStaticOnly && fixed < options.min_points) {
    AddCube({cube.centre, 2 * cube.side}, (options.min_points - fixed) / 2, 0, seed, &starts);
  }
  if (bodies != SceneBodies::kObjectOnly && fixed < options.min_points) {
    const int64_t missing = options.min_points - fixed;
    AddSphere(cube, radius, bodies == SceneBodies::kStaticOnly ? missing - missing / 2 : missing,
              bodies == SceneBodies::kStaticOnly ? 0 : 1 - options.sparse_foreground, seed, &starts);
  }
  const auto added = static_cast<int64_t>(starts.size()) - rotating - fixed;
  if (bodies == SceneBodies::kBoth && rotating == 0) {
    // Measured on four scenes: from random points 3,000 iterations learn no mask, where 2,000 from points do.
    reporter.Warn(
        "the rotating part's model has no points, so training starts at random there: it takes many times "
        "the "
        "iterations and may not tell what turns at all. Give it points, or masks by --masks_as_hint 1");
  }
  reporter.Info("start from " + std::to_string(rotating) + " points of the rotating part, " +
                std::to_string(fixed) + " of the background and " +
                std::to_string(std::max<int64_t>(added, 0)) + " random ones");
  return starts;
}

}  // namespace

OptionCheck InitialiseOptions::Check() const {
  if (num_random_points < 1) {
    return OptionFault{"num_random_points", std::to_string(num_random_points), "num_random_points >= 1"};
  }
  if (min_points < 1) return OptionFault{"min_points", std::to_string(min_points), "min_points >= 1"};
  if (max_points < 1) return OptionFault{"max_points", std::to_string(max_points), "max_points >= 1"};
  if (!(opacity > 0 && opacity < 1)) {
    return OptionFault{"opacity", NumberText(opacity), "0 < opacity < 1"};
  }
  if (!(random_foreground > 0 && random_foreground < 1)) {
    return OptionFault{"random_foreground", NumberText(random_foreground), "0 < random_foreground < 1"};
  }
  if (!(sparse_foreground >= 0.5 && sparse_foreground < 1)) {
    return OptionFault{"sparse_foreground", NumberText(sparse_foreground), "0.5 <= sparse_foreground < 1"};
  }
  if (!(background_radius_sides > 0)) {
    return OptionFault{"background_radius_sides", NumberText(background_radius_sides),
                       "background_radius_sides > 0"};
  }
  return std::nullopt;
}

Gaussians InitialiseGaussians(const TrainingScene& scene, const InitialiseOptions& options, uint64_t seed,
                              Reporter& reporter) {
  const std::vector<Start> starts = ChooseStarts(scene, options, seed, reporter);
  std::vector<float> points;
  points.reserve(3 * starts.size());
  for (const Start& start : starts) {
    for (int i = 0; i < 3; ++i) points.push_back(static_cast<float>(start.x[i]));
  }
  const Neighbours near = FindNeighbours(points, kScaleNeighbours);

  Gaussians gaussians;
  gaussians.Resize(starts.size());
  for (size_t i = 0; i < starts.size(); ++i) {
    float mean_sq = 0;
    for (int j = 0; j < near.k; ++j) mean_sq += near.distance_sq[i * near.k + j] / static_cast<float>(near.k);
    const float log_scale = 0.5F * std::log(std::max(mean_sq, kMinDistance));
    // Uniform over rotations (Shoemake).
    const Random4 bits = RandomBits(seed, kRotationStream, i);
    const double a = Unit(bits, 0);
    const double b = 2 * kPi * Unit(bits, 1);
    const double c = 2 * kPi * Unit(bits, 2);
    const std::array<double, 4> q = {std::sqrt(1 - a) * std::sin(b), std::sqrt(1 - a) * std::cos(b),
                                     std::sqrt(a) * std::sin(c), std::sqrt(a) * std::cos(c)};
    for (int j = 0; j < 3; ++j) {
      gaussians.centre[3 * i + j] = points[3 * i + j];
      gaussians.sh_dc[3 * i + j] = static_cast<float>((starts[i].rgb[j] - 0.5) / kShBand0);
    }
    for (int j = 0; j < 2; ++j) gaussians.log_scale[2 * i + j] = log_scale;
    for (int j = 0; j < 4; ++j) gaussians.rotation[4 * i + j] = static_cast<float>(q[j]);
    gaussians.opacity_logit[i] = static_cast<float>(Logit(options.opacity));
    gaussians.foreground_logit[i] = static_cast<float>(Logit(starts[i].foreground));
  }
  return gaussians;
}

}  // namespace s2gs
