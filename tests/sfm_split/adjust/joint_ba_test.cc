#include "sfm_split/adjust/joint_ba.h"

#include <ceres/ceres.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <random>
#include <utility>
#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/joint_system/dense_schur.h"
#include "sfm_split/joint_system/joint_system.h"
#include "tests/support/measured_bound.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

// A turntable scene with exact or noisy observations. The anchor's pose and the held coordinate of the axis
// are those of the truth, so that adjusted problems can be compared with it number by number.
struct Scene {
  int stations = 3;
  int steps = 12;
  double step_deg = 30;
  int object_points = 150;
  int background_points = 150;
  double noise_px = 0;
  double drift_px = 0;  // of all keypoints of a point alike
  double outliers = 0;
  double shake = 0;       // of each image's camera, relative to the distance of 1
  double wobble_deg = 0;  // of the object at each image
  double elevation_step_deg = 12;
  double focal = 800;
  double visible = 0.5;  // share of the object's points that an image sees
  CameraModelId model = CameraModelId::kSimpleRadial;
  JointProblem truth;
  JointProblem start;

  void Build(uint32_t seed) {
    std::mt19937 rng(seed);
    std::normal_distribution<double> normal;
    std::uniform_real_distribution<double> uniform;
    const auto vector = [&] { return Vector3d(normal(rng), normal(rng), normal(rng)); };
    truth = JointProblem();
    Camera camera;
    camera.camera_id = 1;
    camera.model = model;
    camera.width = 640;
    camera.height = 480;
    camera.params = {focal, 320, 240};
    if (model == CameraModelId::kPinhole) camera.params = {focal, focal, 320, 240};
    if (model == CameraModelId::kSimpleRadial) camera.params.push_back(0.03);
    truth.cameras = {camera};
    truth.axis << 0.02, -0.03, 0.01, 0.02;
    for (int i = 0; i < object_points; ++i) {
      // In a cylinder that fills about half of the image.
      const double extent = 0.3 * 320 / focal;
      truth.object.points.push_back(
          extent * Vector3d(2 * uniform(rng) - 1, 2 * uniform(rng) - 1, 2 * uniform(rng) - 1));
    }
    for (int i = 0; i < background_points; ++i) {
      const Vector3d direction = vector();
      const double extent = std::min(1.0, 400 / focal);  // a long lens sees little
      truth.background.points.push_back(extent *
                                        (Vector3d(-0.8, 0, -0.3) + 0.5 * direction.cwiseMin(2).cwiseMax(-2)));
    }
    for (int s = 0; s < stations; ++s) {
      const double elevation = (20 + elevation_step_deg * s) * kDegree;
      const double azimuth = 8 * s * kDegree;
      const Vector3d centre(std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth),
                            std::sin(elevation));
      Matrix3d world_from_cam;
      world_from_cam.col(2) = -centre.normalized();
      world_from_cam.col(0) = world_from_cam.col(2).cross(Vector3d::UnitZ()).normalized();
      world_from_cam.col(1) = world_from_cam.col(2).cross(world_from_cam.col(0));
      truth.cam_from_world.push_back(Rigid3{Eigen::Quaterniond(world_from_cam), centre}.Inverse());
      for (int k = 0; k < steps; ++k) {
        JointImage image;
        image.name = "s" + std::to_string(s) + "_" + std::to_string(k);
        image.pose = s;
        image.angle_rad = WrapAngle(k * step_deg * kDegree);
        truth.images.push_back(image);
      }
    }
    std::map<std::pair<bool, int>, Vector2d> drifts;
    for (int i = 0; i < static_cast<int>(truth.images.size()); ++i) {
      Rigid3 cam_from_world = truth.cam_from_world[truth.images[i].pose];
      if (i != truth.reference) {
        cam_from_world = Rigid3{Eigen::Quaterniond(ExpRotation<double>(shake * vector())), shake * vector()} *
                         cam_from_world;
      }
      Rigid3 world_from_object = truth.WorldFromObject(i);
      if (i != truth.reference) {
        world_from_object = Rigid3{Eigen::Quaterniond(ExpRotation<double>(wobble_deg * kDegree * vector())),
                                   Vector3d::Zero()} *
                            world_from_object;
      }
      for (JointBody* body : {&truth.object, &truth.background}) {
        const bool of_object = body == &truth.object;
        for (int p = 0; p < static_cast<int>(body->points.size()); ++p) {
          if (of_object && uniform(rng) > visible) continue;
          Vector3d x = body->points[p];
          if (of_object) x = world_from_object * x;
          const std::optional<Vector2d> xy = ProjectToImage(camera, cam_from_world * x);
          if (!xy || (cam_from_world * x).z() < 0.1 || xy->x() < 0 || xy->y() < 0 || xy->x() > 640 ||
              xy->y() > 480) {
            continue;
          }
          JointObservation observation;
          observation.image = i;
          observation.point = p;
          observation.xy = *xy + noise_px * Vector2d(normal(rng), normal(rng));
          if (drift_px > 0) {
            Vector2d& drift = drifts.try_emplace({of_object, p}, Vector2d::Zero()).first->second;
            if (drift.isZero()) drift = drift_px * Vector2d(normal(rng), normal(rng));
            observation.xy += drift;
          }
          if (uniform(rng) < outliers) observation.xy += 40 * Vector2d(normal(rng), normal(rng));
          body->observations.push_back(observation);
        }
      }
    }
    start = truth;
  }

  // Moves everything but the gauge.
  void Perturb(double amount, double focal_factor, uint32_t seed) {
    std::mt19937 rng(seed);
    std::normal_distribution<double> normal;
    const auto vector = [&] { return Vector3d(normal(rng), normal(rng), normal(rng)); };
    for (size_t s = 1; s < start.cam_from_world.size(); ++s) {
      start.cam_from_world[s] =
          Rigid3{Eigen::Quaterniond(ExpRotation<double>(amount * vector())), amount * vector()} *
          start.cam_from_world[s];
    }
    for (size_t i = 1; i < start.images.size(); ++i) start.images[i].angle_rad += amount * normal(rng);
    start.axis(0) += amount * normal(rng);
    start.axis(1) += amount * normal(rng);
    start.axis(3) += amount * normal(rng);  // the anchor is farther in x: that coordinate is held
    for (Vector3d& x : start.object.points) x += amount * vector();
    for (Vector3d& x : start.background.points) x += amount * vector();
    start.cameras[0].params[0] *= focal_factor;
  }
};

double MaxError(const JointProblem& a, const JointProblem& b) {
  double worst = (a.axis - b.axis).cwiseAbs().maxCoeff();
  for (size_t s = 0; s < a.cam_from_world.size(); ++s) {
    worst = std::max(worst, AngleBetween(a.cam_from_world[s].rotation, b.cam_from_world[s].rotation));
    worst = std::max(worst, (CameraCentre(a.cam_from_world[s]) - CameraCentre(b.cam_from_world[s])).norm());
  }
  for (size_t i = 0; i < a.images.size(); ++i) {
    worst = std::max(worst, std::abs(WrapAngle(a.images[i].angle_rad - b.images[i].angle_rad)));
  }
  for (size_t c = 0; c < a.cameras.size(); ++c) {
    for (size_t k = 0; k < a.cameras[c].params.size(); ++k) {
      worst = std::max(worst, std::abs(a.cameras[c].params[k] - b.cameras[c].params[k]) / 1000);
    }
  }
  return worst;
}

JointOptions Exact() {
  JointOptions options;
  options.function_tolerance = 1e-30;
  options.num_threads = 2;
  return options;
}

TEST(JointBa, ExactObservationsGiveTheExactScene) {
  double worst = 0;
  for (int stations = 2; stations <= 4; ++stations) {
    for (const CameraModelId model : {CameraModelId::kSimpleRadial, CameraModelId::kPinhole}) {
      Scene scene;
      scene.stations = stations;
      scene.model = model;
      scene.Build(static_cast<uint32_t>(stations));
      scene.Perturb(0.005, 1.02, 1);
      Reporter reporter;
      const JointReport report = AdjustJointly(Exact(), reporter, &scene.start);
      worst = std::max(worst, MaxError(scene.start, scene.truth));
      EXPECT_EQ(report.model, JointModel::kSharedStations);
      EXPECT_LT(report.object_rms_px, 1e-8);
      EXPECT_EQ(report.removed_observations, 0);
      EXPECT_EQ(report.observability.nullity, 0);
    }
  }
  ExpectWithin(numerics::kGeometry, "joint adjustment of exact observations, largest error of a parameter",
               "double", worst, 1e-9);
}

TEST(JointBa, OneStationIsAdjustedWithoutABackground) {
  Scene scene;
  scene.stations = 1;
  scene.steps = 36;
  scene.step_deg = 10;
  scene.background_points = 0;
  scene.Build(5);
  scene.Perturb(0.003, 1.01, 2);
  Reporter reporter;
  const JointReport report = AdjustJointly(Exact(), reporter, &scene.start);
  EXPECT_LT(MaxError(scene.start, scene.truth), 1e-9);
  EXPECT_EQ(report.observability.nullity, 0);
  EXPECT_EQ(report.scale_sigma_rel, std::numeric_limits<double>::infinity());
}

TEST(JointBa, TheScalesStandardDeviationDoesNotDependOnTheOrigin) {
  Scene scene;
  scene.background_points = 80;
  scene.noise_px = 0.5;
  scene.Build(7);
  JointProblem moved = scene.start;
  const Vector3d shift(0.7, -0.4, 0);  // of centres that are 1 apart from the axis
  for (Rigid3& pose : moved.cam_from_world) pose = pose * Rigid3{Eigen::Quaterniond::Identity(), -shift};
  moved.axis.tail<2>() += shift.head<2>();
  for (JointBody* body : {&moved.object, &moved.background}) {
    for (Vector3d& x : body->points) x += shift;
  }
  JointOptions options;
  options.model = JointModel::kSharedStations;
  Reporter silent;
  const double sigma = AdjustJointly(options, silent, &scene.start).scale_sigma_rel;
  EXPECT_GT(sigma, 1e-6);
  EXPECT_LT(sigma, 1e-2);
  // The same optimum, to where the adjustment ends.
  EXPECT_NEAR(AdjustJointly(options, silent, &moved).scale_sigma_rel / sigma, 1, 1e-3);
}

// A background that only one station sees has no depth: its points go, the rest is adjusted.
TEST(JointBa, BackgroundOfOneStationIsTakenOut) {
  Scene scene;
  scene.stations = 1;
  scene.steps = 20;
  scene.step_deg = 18;
  scene.Build(6);
  scene.Perturb(0.003, 1.0, 3);
  Reporter reporter;
  const JointReport report = AdjustJointly(Exact(), reporter, &scene.start);
  EXPECT_EQ(report.background_observations, 0);
  EXPECT_GT(report.undetermined_points, 50);
  EXPECT_LT(MaxError(scene.start, scene.truth), 1e-9);
}

TEST(JointBa, OutliersAreTakenOutAndDoNoHarm) {
  Scene scene;
  scene.noise_px = 0.3;
  scene.outliers = 0.15;
  scene.Build(7);
  scene.Perturb(0.005, 1.02, 4);
  Reporter reporter;
  JointOptions options;
  options.num_threads = 2;
  const JointReport report = AdjustJointly(options, reporter, &scene.start);
  EXPECT_EQ(report.model, JointModel::kSharedStations);
  EXPECT_NEAR(report.sigma_px, 0.3, 0.03);
  const size_t all = scene.truth.object.observations.size() + scene.truth.background.observations.size();
  EXPECT_NEAR(report.removed_observations / static_cast<double>(all), 0.15, 0.02);
  EXPECT_LT(MaxError(scene.start, scene.truth), 0.01);
  for (size_t i = 0; i < scene.start.images.size(); ++i) {
    EXPECT_LT(std::abs(WrapAngle(scene.start.images[i].angle_rad - scene.truth.images[i].angle_rad)),
              5 * report.angle_sigma_deg[i] * kDegree + 1e-15);
  }
}

// Errors over predicted standard deviations, over seeds: root mean squares near 1.
TEST(JointBa, CovariancePredictsTheErrors) {
  double axis = 0;
  double angle = 0;
  double focal = 0;
  double scale = 0;
  int angles = 0;
  const int seeds = 16;
  for (uint32_t seed = 0; seed < seeds; ++seed) {
    Scene scene;
    scene.noise_px = 0.5;
    scene.steps = 8;
    scene.step_deg = 45;
    scene.object_points = 80;
    scene.background_points = 80;
    scene.Build(100 + seed);
    Reporter reporter;
    JointOptions options;
    options.model = JointModel::kSharedStations;
    options.num_threads = 2;
    const JointReport report = AdjustJointly(options, reporter, &scene.start);
    const auto square = [](double x) { return x * x; };
    axis += square((scene.start.AxisDirection() - scene.truth.AxisDirection()).norm() / kDegree /
                   report.axis_direction_sigma_deg);
    focal += square((scene.start.cameras[0].params[0] - 800) / report.focal_sigma_px[0]);
    const auto log_scale = [](const JointProblem& p) {
      const Vector3d anchor = CameraCentre(p.cam_from_world[0]);
      return std::log(p.AxisDirection().cross(anchor - p.AxisPoint()).norm() /
                      (CameraCentre(p.cam_from_world[2]) - anchor).norm());
    };
    scale += square((log_scale(scene.start) - log_scale(scene.truth)) / report.scale_sigma_rel);
    for (size_t i = 1; i < scene.start.images.size(); ++i) {
      angle += square(WrapAngle(scene.start.images[i].angle_rad - scene.truth.images[i].angle_rad) / kDegree /
                      report.angle_sigma_deg[i]);
      ++angles;
    }
  }
  EXPECT_THAT(std::sqrt(axis / seeds), testing::AllOf(testing::Ge(0.6), testing::Le(1.7)));
  EXPECT_THAT(std::sqrt(angle / angles), testing::AllOf(testing::Ge(0.75), testing::Le(1.35)));
  EXPECT_THAT(std::sqrt(focal / seeds), testing::AllOf(testing::Ge(0.5), testing::Le(1.6)));
  EXPECT_THAT(std::sqrt(scale / seeds), testing::AllOf(testing::Ge(0.5), testing::Le(1.6)));
}

// Where each photo has a pose of the object of its own, the axis is what these turn about.
TEST(JointBa, TheAxisOfAnObjectWithPosesOfItsOwnLiesWithinItsStandardDeviation) {
  double axis = 0;
  const int seeds = 12;
  for (uint32_t seed = 0; seed < seeds; ++seed) {
    Scene scene;
    scene.stations = 1;
    scene.background_points = 0;
    scene.noise_px = 0.5;
    scene.Build(500 + seed);
    Reporter reporter;
    JointOptions options;
    options.model = JointModel::kFreeObject;
    options.num_threads = 2;
    const JointReport report = AdjustJointly(options, reporter, &scene.start);
    ASSERT_EQ(report.model, JointModel::kFreeObject);
    const JointProblem& found = scene.start;
    const Matrix3d reference = found.WorldFromObject(found.reference).rotation.toRotationMatrix();
    Matrix3d moved = Matrix3d::Zero();
    for (size_t i = 0; i < found.images.size(); ++i) {
      const Matrix3d turn =
          found.WorldFromObject(static_cast<int>(i)).rotation.toRotationMatrix() * reference.transpose() -
          Matrix3d::Identity();
      moved += turn.transpose() * turn;
    }
    const Vector3d about = Eigen::SelfAdjointEigenSolver<Matrix3d>(moved).eigenvectors().col(0);
    const double error = about.cross(scene.truth.AxisDirection()).norm() / kDegree;
    axis += std::pow(error / report.axis_direction_sigma_deg, 2) / seeds;
  }
  EXPECT_THAT(std::sqrt(axis), testing::AllOf(testing::Ge(0.6), testing::Le(1.7)));
}

// Matches of highlights, which lie to one side of the true ones in the later photo of two: what they pull by
// is no matter of chance, but stands in the axis' standard deviation.
TEST(JointBa, TheAxisIsWrongByNoMoreThanItSaysWhenWrongTracksAllPullToOneSide) {
  double stated = 0;
  double by_noise = 0;
  const int seeds = 8;
  for (uint32_t seed = 0; seed < seeds; ++seed) {
    Scene scene;
    scene.stations = 1;
    scene.background_points = 0;
    scene.noise_px = 0.3;
    scene.object_points = 1600;
    scene.visible = 0.25;
    scene.Build(300 + seed);
    std::map<int, int> photos;
    for (JointObservation& observation : scene.start.object.observations) {
      const int nth = photos[observation.point]++;
      observation.active = nth < 2;
      if (nth == 1 && observation.point % 4 == 0) observation.xy.y() += 1;
    }
    Reporter reporter;
    JointOptions options;
    options.model = JointModel::kSharedStations;
    options.num_threads = 2;
    const JointReport report = AdjustJointly(options, reporter, &scene.start);
    const Observability& of = report.observability;
    ASSERT_TRUE(of.computed);
    const double error = (scene.start.AxisDirection() - scene.truth.AxisDirection()).norm() / kDegree;
    double noise = 0;  // variance
    for (size_t k = 0; k < of.names.size(); ++k) {
      const auto at = static_cast<Eigen::Index>(k);
      if (of.names[k] != "axis direction") continue;
      for (const Eigen::MatrixXd* covariance :
           {&of.covariance, &of.robust_covariance, &of.regional_covariance})
        noise = std::max(noise, (*covariance)(at, at));
    }
    stated += std::pow(error / report.axis_direction_sigma_deg, 2) / seeds;
    by_noise += std::pow(error * kDegree, 2) / noise / seeds;
  }
  // .96 and 1.60 here.
  EXPECT_LE(std::sqrt(stated), 1.35);
  EXPECT_GE(std::sqrt(by_noise), 1.35);
}

// The standard deviations from the residuals, over those for independent errors, where errors are
// independent.
TEST(JointBa, RobustCovarianceIsTheOrdinaryOneForIndependentErrors) {
  for (const JointLoss loss : {JointLoss::kSquared, JointLoss::kHuber, JointLoss::kCauchy}) {
    std::vector<double> ratios;
    for (uint32_t seed = 0; seed < 6; ++seed) {
      Scene scene;
      scene.noise_px = 0.5;
      scene.object_points = 250;
      scene.background_points = 250;
      scene.Build(300 + seed);
      Reporter reporter;
      JointOptions options;
      options.model = JointModel::kSharedStations;
      options.loss = loss;
      const Observability found = AdjustJointly(options, reporter, &scene.start).observability;
      const Eigen::VectorXd of_seed =
          (found.robust_covariance.diagonal().array() / found.covariance.diagonal().array()).sqrt();
      ratios.insert(ratios.end(), of_seed.data(), of_seed.data() + of_seed.size());
    }
    std::sort(ratios.begin(), ratios.end());
    // Measured: medians of 1.02, 90 % within 0.91 to 1.13.
    EXPECT_NEAR(ratios[ratios.size() / 2], 1, 0.06) << static_cast<int>(loss);
    EXPECT_GE(ratios[ratios.size() / 20], 0.85) << static_cast<int>(loss);
    EXPECT_LE(ratios[ratios.size() * 19 / 20], 1.2) << static_cast<int>(loss);
  }
}

struct Coverage {
  int within = 0;  // two standard deviations
  int all = 0;
  double squares = 0;  // of errors over standard deviations

  void Add(double error, double sigma) {
    within += std::abs(error) <= 2 * sigma ? 1 : 0;
    ++all;
    squares += error * error / (sigma * sigma);
  }
  void Add(const Coverage& other) {
    within += other.within;
    all += other.all;
    squares += other.squares;
  }
  double Share() const { return static_cast<double>(within) / all; }
  double Rms() const { return std::sqrt(squares / all); }
};

// Truths within two standard deviations, which 95.4 % of normal errors are.
struct Coverages {
  Coverage focal;
  Coverage angle;
  Coverage ordinary_focal;  // by the covariance for independent errors alone
};

Coverages MeasureCoverage(double noise_px, double drift_px, double outliers, int stations) {
  Coverages coverages;
  for (uint32_t seed = 0; seed < 40; ++seed) {
    Scene scene;
    scene.noise_px = noise_px;
    scene.drift_px = drift_px;
    scene.outliers = outliers;
    scene.stations = stations;
    scene.steps = 8;
    scene.step_deg = 45;
    scene.object_points = stations == 1 ? 200 : 80;
    scene.background_points = stations == 1 ? 0 : 80;
    scene.Build(500 + seed);
    Reporter reporter;
    JointOptions options;
    options.model = JointModel::kSharedStations;
    const JointReport report = AdjustJointly(options, reporter, &scene.start);
    const double focal_error = scene.start.cameras[0].params[0] - scene.focal;
    coverages.focal.Add(focal_error, report.focal_sigma_px[0]);
    for (size_t i = 1; i < scene.start.images.size(); ++i) {
      const double error = WrapAngle(scene.start.images[i].angle_rad - scene.truth.images[i].angle_rad);
      if (report.angle_sigma_deg[i] > 0 && std::isfinite(report.angle_sigma_deg[i]))
        coverages.angle.Add(error / kDegree, report.angle_sigma_deg[i]);
    }
    const Observability& found = report.observability;
    for (Eigen::Index k = 0; k < found.covariance.rows(); ++k) {
      if (found.names[static_cast<size_t>(k)] == "camera 0 focal length")
        coverages.ordinary_focal.Add(focal_error, std::sqrt(found.covariance(k, k)));
    }
  }
  return coverages;
}

TEST(JointBa, TruthLiesWithinTheStandardDeviations) {
  Coverages all;
  for (const int stations : {3, 1}) {
    for (const double outliers : {0.1, 0.15}) {
      const Coverages found = MeasureCoverage(0.5, 0, outliers, stations);
      all.focal.Add(found.focal);
      all.angle.Add(found.angle);
    }
  }
  EXPECT_EQ(all.focal.all, 160);
  // Measured: 93.8 and 96.6 %, errors over standard deviations 1.06 and 0.95.
  EXPECT_THAT(all.focal.Share(), testing::AllOf(testing::Ge(0.90), testing::Le(0.99)));
  EXPECT_THAT(all.focal.Rms(), testing::AllOf(testing::Ge(0.85), testing::Le(1.2)));
  EXPECT_THAT(all.angle.Share(), testing::AllOf(testing::Ge(0.93), testing::Le(0.99)));
  EXPECT_THAT(all.angle.Rms(), testing::AllOf(testing::Ge(0.85), testing::Le(1.15)));
}

// Errors that a point's keypoints share count, though not in full: standard deviations for independent errors
// would be too small by half.
TEST(JointBa, ErrorsThatATrackSharesWidenTheStandardDeviations) {
  const Coverages found = MeasureCoverage(0.3, 0.6, 0, 3);
  // Measured: 97.5 and 86 %, errors over standard deviations 1.12, over those for independent errors 1.53.
  EXPECT_GE(found.focal.Share(), 0.88);
  EXPECT_GE(found.angle.Share(), 0.82);
  EXPECT_LE(found.focal.Rms(), 1.3);
  EXPECT_GE(found.ordinary_focal.Rms(), 1.2 * found.focal.Rms());
}

// Terms, losses and what is held of a system as a problem of Ceres, which moves the system's own values.
void FillCeres(const JointSystem& system, ceres::LossFunction* loss, ceres::Problem* problem,
               std::vector<const double*>* free_blocks) {
  for (const JointSystem::Term& term : system.terms()) {
    ceres::LossFunction* scaled = nullptr;  // the problem's own
    if (loss != nullptr) scaled = new ceres::ScaledLoss(loss, term.weight, ceres::DO_NOT_TAKE_OWNERSHIP);
    problem->AddResidualBlock(term.cost.get(), scaled, term.values.data(), term.num_blocks + 1);
  }
  for (const JointSystem::Block& block : system.blocks()) {
    if (!block.used) continue;
    std::vector<int> held;
    for (int k = 0; k < block.size; ++k) {
      if (std::find(block.free.begin(), block.free.end(), k) == block.free.end()) held.push_back(k);
    }
    if (block.free.empty()) {
      problem->SetParameterBlockConstant(block.values);
    } else {
      if (!held.empty()) problem->SetManifold(block.values, new ceres::SubsetManifold(block.size, held));
      free_blocks->push_back(block.values);
    }
  }
}

// The same minimum as Ceres' own solver, by QR of the whole Jacobian, and the same bits for any number of
// threads.
TEST(JointBa, DenseSchurEndsWhereCeresDoes) {
  for (const JointLoss kind : {JointLoss::kSquared, JointLoss::kHuber, JointLoss::kCauchy}) {
    Scene scene;
    scene.steps = 5;
    scene.step_deg = 40;
    scene.object_points = 40;
    scene.background_points = 30;
    scene.noise_px = 0.5;
    scene.outliers = 0.02;
    scene.Build(8);
    scene.Perturb(0.005, 1.02, 4);
    for (size_t k = 0; k < scene.start.object.observations.size(); k += 3)
      scene.start.object.observations[k].weight = 0.5;
    JointOptions options;
    options.loss = kind;
    options.loss_scale_px = 1;
    FilterObservations(options, 1e3, &scene.start);
    const std::unique_ptr<ceres::LossFunction> loss =
        kind == JointLoss::kSquared ? std::make_unique<ceres::TrivialLoss>() : MakeLoss(options);

    const JointSystem theirs(scene.start, options, true);
    ceres::Problem::Options keep;
    keep.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    ceres::Problem problem(keep);
    std::vector<const double*> free_blocks;
    FillCeres(theirs, loss.get(), &problem, &free_blocks);
    ceres::Solver::Options solver;
    solver.linear_solver_type = ceres::DENSE_QR;
    solver.function_tolerance = 1e-14;
    solver.gradient_tolerance = 1e-14;
    solver.parameter_tolerance = 1e-14;
    solver.max_num_iterations = 200;
    solver.logging_type = ceres::SILENT;
    ceres::Solver::Summary summary;
    ceres::Solve(solver, &problem, &summary);
    JointProblem expected = scene.start;
    theirs.WriteBack(&expected);

    DenseSchurOptions ours;
    ours.function_tolerance = 1e-14;
    ours.max_iterations = 200;
    JointProblem first;
    for (const int threads : {1, 2, 5}) {
      ours.num_threads = threads;
      const JointSystem system(scene.start, options, true);
      Reporter silent;
      const DenseSchurSummary found = SolveDenseSchur(system, MakeLoss(options).get(), ours, silent);
      EXPECT_TRUE(found.converged);
      EXPECT_LT(std::abs(found.cost - summary.final_cost), 1e-9 * summary.final_cost);  // measured 2e-13
      JointProblem result = scene.start;
      system.WriteBack(&result);
      EXPECT_LT(MaxError(result, expected), 1e-6);  // measured 1e-8
      if (threads == 1) first = result;
      EXPECT_EQ(MaxError(result, first), 0);
      EXPECT_EQ(result.object.points, first.object.points);
    }
    EXPECT_GT(MaxError(first, scene.start), 1e-3);
  }
}

// The covariance of the reduced system against Ceres', by dense decomposition of the whole Jacobian.
TEST(JointBa, CovarianceEqualsCeres) {
  Scene scene;
  scene.steps = 5;
  scene.step_deg = 40;
  scene.object_points = 30;
  scene.background_points = 30;
  scene.Build(8);
  JointOptions options;
  options.loss = JointLoss::kSquared;
  FilterObservations(options, 10, &scene.truth);
  const Observability ours = AnalyzeObservability(scene.truth, options, true, 1);
  ASSERT_TRUE(ours.computed);
  ASSERT_EQ(ours.nullity, 0);
  const JointSystem system(scene.truth, options, true);
  ceres::Problem::Options keep;
  keep.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ceres::Problem problem(keep);
  std::vector<const double*> blocks;
  FillCeres(system, nullptr, &problem, &blocks);
  ceres::Covariance::Options covariance_options;
  covariance_options.algorithm_type = ceres::DENSE_SVD;
  covariance_options.null_space_rank = 0;
  ceres::Covariance covariance(covariance_options);
  ASSERT_TRUE(covariance.Compute(blocks, &problem));
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> theirs(ours.covariance.rows(),
                                                                                ours.covariance.cols());
  ASSERT_TRUE(covariance.GetCovarianceMatrixInTangentSpace(blocks, theirs.data()));
  const Eigen::VectorXd sigma = theirs.diagonal().cwiseSqrt();
  const Eigen::MatrixXd error =
      sigma.cwiseInverse().asDiagonal() * (theirs - ours.covariance) * sigma.cwiseInverse().asDiagonal();
  EXPECT_LT(error.cwiseAbs().maxCoeff(), 1e-6);  // measured 3e-9
}

TEST(JointBa, WithoutAGaugeTheNullityCountsItsFreedoms) {
  Scene scene;
  scene.Build(9);
  JointOptions options;
  FilterObservations(options, 10, &scene.truth);
  // A similarity of the world, and the object's frame turned about the axis against the angles.
  const Observability free = AnalyzeObservability(scene.truth, options, false, 1);
  EXPECT_EQ(free.nullity, 8);
  EXPECT_GT(free.gap, 1e3) << free.eigenvalues.head(12).transpose();
  EXPECT_EQ(AnalyzeObservability(scene.truth, options, true, 1).nullity, 0);

  JointProblem free_object = scene.truth;
  for (size_t i = 0; i < free_object.images.size(); ++i) {
    free_object.images[i].world_from_object = scene.truth.WorldFromObject(static_cast<int>(i));
  }
  free_object.free_object = true;
  // A similarity of the world and another of the object's frame.
  EXPECT_EQ(AnalyzeObservability(free_object, options, false, 1).nullity, 14);
  EXPECT_EQ(AnalyzeObservability(free_object, options, true, 1).nullity, 0);
}

TEST(JointBa, WithoutABackgroundTheStationsTurnFreely) {
  Scene scene;
  scene.background_points = 0;
  scene.Build(10);
  JointOptions options;
  // Two more stations, each free to turn with its images' angles.
  EXPECT_EQ(AnalyzeObservability(scene.truth, options, false, 1).nullity, 10);
  EXPECT_EQ(AnalyzeObservability(scene.truth, options, true, 1).nullity, 0);
  scene.Perturb(0.003, 1.01, 2);
  Reporter reporter;
  const JointReport report = AdjustJointly(Exact(), reporter, &scene.start);
  EXPECT_EQ(report.model, JointModel::kSharedStations);
  EXPECT_LT(report.object_rms_px, 1e-8);
  EXPECT_EQ(report.scale_sigma_rel, std::numeric_limits<double>::infinity());
}

// Nor is a table's angle known from station to station where its object wobbles.
TEST(JointBa, WithoutABackgroundAnglesOfAWobblingObjectAreKnownInsideTheFirstStationAlone) {
  Scene scene;
  scene.stations = 2;
  scene.background_points = 0;
  scene.noise_px = 0.3;
  scene.wobble_deg = 0.3;
  scene.Build(11);
  JointOptions options;
  options.model = JointModel::kFreeObject;
  Reporter reporter;
  const JointReport report = AdjustJointly(options, reporter, &scene.start);
  ASSERT_EQ(report.angle_sigma_deg.size(), scene.start.images.size());
  for (size_t i = 0; i < scene.start.images.size(); ++i) {
    EXPECT_EQ(std::isfinite(report.angle_sigma_deg[i]), scene.start.images[i].pose == 0)
        << scene.start.images[i].name;
  }
}

// What cannot be known is named: here the focal length, when the table stands still and all cameras are one.
TEST(JointBa, UnobservableDirectionsAreNamed) {
  Scene scene;
  scene.stations = 2;
  scene.step_deg = 0;
  scene.background_points = 0;
  scene.Build(11);
  JointOptions options;
  options.min_triangulation_deg = 0;
  const Observability still = AnalyzeObservability(scene.truth, options, true, 1);
  EXPECT_GT(still.nullity, 0);
  bool axis_named = false;
  for (const std::string& direction : still.null_directions) {
    axis_named = axis_named || direction.find("axis") != std::string::npos;
  }
  EXPECT_TRUE(axis_named);
  Reporter reporter;
  scene.Perturb(0.002, 1, 1);
  const JointReport report = AdjustJointly(options, reporter, &scene.start);
  EXPECT_GT(report.observability.nullity, 0);
  EXPECT_TRUE(scene.start.axis.allFinite());
  ExpectWithin(numerics::kGeometry, "unobservable scene whose nullity is not reported", "double",
               still.nullity > 0 && report.observability.nullity > 0 ? 0 : 1, 0);
}

TEST(JointBa, ZeroBaselineLeavesTheScaleUnobservable) {
  Scene scene;
  scene.stations = 3;
  scene.Build(12);
  // All stations at one place, with different views of the background.
  JointProblem& problem = scene.truth;
  const Vector3d centre = CameraCentre(problem.cam_from_world[0]);
  for (int s = 1; s < 3; ++s) {
    Rigid3& pose = problem.cam_from_world[s];
    pose.rotation = Eigen::Quaterniond(Eigen::AngleAxisd(0.05 * s, Vector3d(1, s, 0).normalized())) *
                    problem.cam_from_world[0].rotation;
    pose.translation = -(pose.rotation * centre);
  }
  for (JointBody* body : {&problem.object, &problem.background}) {
    for (JointObservation& observation : body->observations) {
      Vector3d x = body->points[observation.point];
      if (body == &problem.object) x = problem.WorldFromObject(observation.image) * x;
      observation.xy = *ProjectToImage(problem.cameras[0],
                                       problem.cam_from_world[problem.images[observation.image].pose] * x);
    }
  }
  scene.start = problem;
  Reporter reporter;
  const JointReport report = AdjustJointly(Exact(), reporter, &scene.start);
  EXPECT_EQ(report.background_observations, 0);  // points without depth
  EXPECT_EQ(report.scale_sigma_rel, std::numeric_limits<double>::infinity());
  EXPECT_TRUE(scene.start.axis.allFinite());
  ExpectWithin(numerics::kGeometry, "zero baseline: residual that is left [px]", "double",
               scene.start.axis.allFinite() ? report.object_rms_px : NAN, 1e-6);
}

TEST(JointBa, FocalLengthsFromWideToTele) {
  double worst = 0;
  for (const double over_width : {0.3, 0.5, 1.0, 3.0, 10.0}) {
    Scene scene;
    scene.focal = over_width * 640;
    scene.model = CameraModelId::kSimplePinhole;
    scene.stations = 3;
    scene.Build(13);
    scene.Perturb(0.002 / over_width, 1.01, 1);
    Reporter reporter;
    JointOptions options = Exact();
    options.max_iterations = 200;
    const JointReport report = AdjustJointly(options, reporter, &scene.start);
    EXPECT_TRUE(report.observability.computed);
    EXPECT_LT(report.object_rms_px, 1e-6) << over_width;
    // A long lens tells less: at 10 x width the observations' rounding alone moves a station by 1e-8.
    const double predicted = std::sqrt(report.observability.covariance.diagonal().maxCoeff());
    EXPECT_LT(MaxError(scene.start, scene.truth), std::max(1e-9, 6 * predicted)) << over_width;
    EXPECT_LT(predicted, 1e-7);
    worst = std::max(worst, MaxError(scene.start, scene.truth) / std::max(1e-9, 6 * predicted));
  }
  ExpectWithin(numerics::kGeometry,
               "focal length .3 to 10 x width: error over 1e-9 or six predicted sigmas of the rounding",
               "double", worst, 1);
}

TEST(JointBa, ShakenCamerasAreFreedOnlyWhenTheDataDemandIt) {
  for (const double shake : {0.0, 0.002}) {
    Scene scene;
    scene.noise_px = 0.4;
    scene.shake = shake;
    scene.Build(14);
    Reporter reporter;
    JointOptions options;
    options.num_threads = 2;
    const JointReport report = AdjustJointly(options, reporter, &scene.start);
    EXPECT_EQ(report.model, shake > 0 ? JointModel::kFreeCameras : JointModel::kSharedStations);
    ASSERT_EQ(report.tests.size(), 2u);
    EXPECT_EQ(report.tests[0].accepted, shake > 0);
    EXPECT_FALSE(report.tests[1].accepted);
    if (shake > 0) {
      EXPECT_GT(report.tests[0].f_statistic, 10);
    } else {
      EXPECT_NEAR(report.tests[0].score, 1, 0.3);
      EXPECT_FALSE(report.tests[0].fitted);
    }
    EXPECT_NEAR(report.sigma_px, 0.4, 0.04);
  }
}

// Weights discount what a station's photos repeat. Within one photo every point is seen once, with an error
// of its own: were the score's gradient weighted too, weights of 1 and .1 by turns would make of its mean of
// 1 the ratio mean(w^2) / mean(w)^2 = 1.67.
TEST(JointBa, ScoresDoNotDependOnHowMuchObservationsCount) {
  Scene scene;
  scene.noise_px = 0.4;
  scene.Build(14);
  for (JointObservation& observation : scene.start.background.observations) {
    observation.weight = observation.point % 2 == 0 ? 1 : 0.1;
  }
  Reporter reporter;
  JointOptions options;
  options.num_threads = 2;
  const JointReport report = AdjustJointly(options, reporter, &scene.start);
  ASSERT_FALSE(report.tests.empty());
  EXPECT_FALSE(report.tests[0].accepted);
  EXPECT_NEAR(report.tests[0].score, 1, 0.3);
}

TEST(JointBa, AWobblingTableFreesTheObjectNotTheCameras) {
  Scene scene;
  scene.noise_px = 0.4;
  scene.wobble_deg = 0.3;
  scene.Build(15);
  Reporter reporter;
  JointOptions options;
  options.num_threads = 2;
  const JointReport report = AdjustJointly(options, reporter, &scene.start);
  EXPECT_EQ(report.model, JointModel::kFreeObject);
  EXPECT_FALSE(report.tests[0].accepted);
  EXPECT_TRUE(report.tests[1].accepted);
  EXPECT_NEAR(report.sigma_px, 0.4, 0.04);
  EXPECT_EQ(scene.start.cam_from_world.size(), 3u);
}

TEST(JointBa, InterruptionThrowsAndLeavesTheProblemAsItWas) {
  class Stopping : public Reporter {
   public:
    void Progress(std::string_view, int64_t done, int64_t) override { stop_ = done >= 1; }
    bool StopRequested() const override { return stop_; }

   private:
    bool stop_ = false;
  };
  Scene scene;
  scene.Build(16);
  scene.Perturb(0.005, 1.02, 1);
  const JointProblem before = scene.start;
  Stopping reporter;
  EXPECT_THROW(AdjustJointly(JointOptions(), reporter, &scene.start), Interrupted);
  EXPECT_EQ(MaxError(before, scene.start), 0);
}

TEST(JointBa, NothingToAdjustIsNoFault) {
  JointProblem empty;
  Reporter reporter;
  EXPECT_EQ(AdjustJointly(JointOptions(), reporter, &empty).object_observations, 0);
  Scene scene;
  scene.object_points = 0;
  scene.background_points = 0;
  scene.Build(17);
  EXPECT_EQ(AdjustJointly(JointOptions(), reporter, &scene.start).object_observations, 0);
}

TEST(JointBa, OptionsAreChecked) {
  JointOptions options;
  EXPECT_FALSE(options.Check());
  options.loss_scale_px = -1;
  EXPECT_EQ(options.Check()->field, "loss_scale_px");
}

}  // namespace
}  // namespace s2gs
