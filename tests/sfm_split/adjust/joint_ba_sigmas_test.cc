#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>
#include <vector>

#include "sfm_split/adjust/joint_ba.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "tests/sfm_split/adjust/joint_scene.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

TEST(JointBa, TheScalesStandardDeviationDoesNotDependOnTheOrigin) {
  JointScene scene;
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

// Errors over predicted standard deviations, over seeds: root mean squares near 1.
TEST(JointBa, CovariancePredictsTheErrors) {
  double axis = 0;
  double angle = 0;
  double focal = 0;
  double scale = 0;
  int angles = 0;
  const int seeds = 16;
  for (uint32_t seed = 0; seed < seeds; ++seed) {
    JointScene scene;
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
    JointScene scene;
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

// Root mean square, over scans without a background, of how far the object is turned before the cameras of a
// station that nothing ties, over what is stated.
double ErrorsOfTurns(JointModel model) {
  double squares = 0;
  int images = 0;
  for (uint32_t seed = 0; seed < 6; ++seed) {
    JointScene scene;
    scene.stations = 2;
    scene.background_points = 0;
    scene.noise_px = 0.5;
    scene.Build(700 + seed);
    Reporter reporter;
    JointOptions options;
    options.model = model;
    options.num_threads = 2;
    const JointReport report = AdjustJointly(options, reporter, &scene.start);
    if (report.turn_sigma_deg.size() != scene.start.images.size()) return -1;
    const auto cam_from_object = [](const JointProblem& problem, size_t i) {
      const Rigid3& pose = problem.cam_from_world[static_cast<size_t>(problem.images[i].pose)];
      return Matrix3d((pose * problem.WorldFromObject(static_cast<int>(i))).rotation);
    };
    const auto moved = [&](size_t i) {
      return Matrix3d(cam_from_object(scene.start, i).transpose() * cam_from_object(scene.truth, i));
    };
    const Matrix3d frame = moved(static_cast<size_t>(scene.start.reference));
    for (size_t i = 0; i < scene.start.images.size(); ++i) {
      if (!std::isinf(report.angle_sigma_deg[i])) continue;
      const double error =
          AngleAbout(scene.truth.AxisDirection(), Matrix3d(moved(i) * frame.transpose())) / kDegree;
      squares += std::pow(error / report.turn_sigma_deg[i], 2);
      ++images;
    }
  }
  EXPECT_GT(images, 30);
  return std::sqrt(squares / images);
}

// Without a background nothing tells the table's angle from station to station; how the object is turned
// before each camera its points tell all the same.
TEST(JointBa, TheTurnOfTheObjectBeforeACameraLiesWithinItsStandardDeviation) {
  // .74 and .72 of 72.
  EXPECT_THAT(ErrorsOfTurns(JointModel::kFreeObject), testing::AllOf(testing::Ge(0.5), testing::Le(1.5)));
  EXPECT_THAT(ErrorsOfTurns(JointModel::kSharedStations), testing::AllOf(testing::Ge(0.5), testing::Le(1.5)));
}

// Matches of highlights, which lie to one side of the true ones in the later photo of two: what they pull by
// is no matter of chance, but stands in the axis' standard deviation.
TEST(JointBa, TheAxisIsWrongByNoMoreThanItSaysWhenWrongTracksAllPullToOneSide) {
  double stated = 0;
  double by_noise = 0;
  const int seeds = 8;
  for (uint32_t seed = 0; seed < seeds; ++seed) {
    JointScene scene;
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
      JointScene scene;
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
    JointScene scene;
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

}  // namespace
}  // namespace s2gs
