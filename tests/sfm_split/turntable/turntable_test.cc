#include "sfm_split/turntable/turntable.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <random>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// A turntable scene seen through two reconstructions, each in a random frame of its own.
struct Rig {
  int stations = 3;
  int steps = 12;
  double step_deg = 30;
  double tilt_deg = 0;  // of the axis in the physical world
  double roll_deg = 0;  // of every camera
  double scale = 0.37;  // background units per object unit
  double rotation_noise_deg = 0;
  double centre_noise = 0;   // of the object's reconstruction, relative to the distance of 1
  double station_noise = 0;  // of the background's, shared by a station's images
  double elevation_step_deg = 12;
  double azimuth_step_deg = 0;
  std::vector<TurntablePose> poses;
  Vector3d axis_in_world, axis_in_object, point_in_world, point_in_object;

  void Build(uint32_t seed) {
    std::mt19937 rng(seed);
    std::normal_distribution<double> normal;
    const auto vector = [&] { return Vector3d(normal(rng), normal(rng), normal(rng)); };
    const Matrix3d background_from_world = ExpRotation<double>(vector());
    const Vector3d background_shift = vector();
    const Matrix3d object_frame_from_physical = ExpRotation<double>(vector());
    const Vector3d object_shift = vector();
    const Vector3d axis = RotationAbout<double>(Vector3d::UnitX(), tilt_deg * kDegree) * Vector3d::UnitZ();
    const Vector3d on_axis(0.03, -0.05, 0.02);
    axis_in_world = background_from_world * axis;
    point_in_world = scale * (background_from_world * on_axis) + background_shift;
    axis_in_object = object_frame_from_physical * axis;
    point_in_object = object_frame_from_physical * on_axis + object_shift;
    poses.clear();
    for (int s = 0; s < stations; ++s) {
      const double elevation = (15 + elevation_step_deg * s) * kDegree;
      const double azimuth = azimuth_step_deg * s * kDegree;
      const Vector3d centre(std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth),
                            std::sin(elevation));
      Matrix3d world_from_cam;
      world_from_cam.col(2) = -centre.normalized();
      world_from_cam.col(0) = Vector3d::UnitZ().cross(centre).normalized() * 1.0;
      world_from_cam.col(1) = world_from_cam.col(2).cross(world_from_cam.col(0));
      world_from_cam = world_from_cam * RotationAbout<double>(Vector3d::UnitZ(), roll_deg * kDegree);
      const Vector3d shared = station_noise * vector();
      for (int k = 0; k < steps; ++k) {
        const Matrix3d turn = RotationAbout<double>(axis, k * step_deg * kDegree);
        // Physical: x_world = turn (x_object - on_axis) + on_axis.
        TurntablePose pose;
        char name[32];
        std::snprintf(name, sizeof(name), "s%d_%03d.jpg", s, k);
        pose.name = name;
        pose.station = s;
        const Matrix3d noise = ExpRotation<double>(rotation_noise_deg * kDegree * vector());
        pose.cam_from_world.rotation =
            Eigen::Quaterniond(Matrix3d(world_from_cam.transpose() * background_from_world.transpose()));
        const Vector3d centre_b = scale * (background_from_world * (centre + shared)) + background_shift;
        pose.cam_from_world.translation = -(pose.cam_from_world.rotation * centre_b);
        const Matrix3d cam_from_object =
            noise * world_from_cam.transpose() * turn * object_frame_from_physical.transpose();
        const Vector3d centre_o =
            object_frame_from_physical * (turn.transpose() * (centre - on_axis) + on_axis) + object_shift;
        // Noise where SfM has it: the object's place in the camera's frame.
        pose.cam_from_object.rotation = Eigen::Quaterniond(cam_from_object);
        const Vector3d axis_in_cam = world_from_cam.transpose() * turn *
                                     object_frame_from_physical.transpose() * (point_in_object - centre_o);
        pose.cam_from_object.translation =
            axis_in_cam - cam_from_object * point_in_object + centre_noise * vector();
        poses.push_back(pose);
      }
    }
  }

  // Replaces a share of the object's poses by nonsense.
  void Spoil(double share, uint32_t seed, std::vector<bool>* spoiled) {
    std::mt19937 rng(seed);
    std::normal_distribution<double> normal;
    spoiled->assign(poses.size(), false);
    std::vector<size_t> order(poses.size());
    for (size_t i = 0; i < order.size(); ++i) order[i] = i;
    std::shuffle(order.begin(), order.end(), rng);
    for (size_t i = 0; i < static_cast<size_t>(share * static_cast<double>(poses.size())); ++i) {
      (*spoiled)[order[i]] = true;
      TurntablePose& pose = poses[order[i]];
      pose.cam_from_object.rotation =
          Eigen::Quaterniond(ExpRotation<double>(Vector3d(normal(rng), normal(rng), normal(rng)))) *
          pose.cam_from_object.rotation;
      pose.cam_from_object.translation += Vector3d(normal(rng), normal(rng), normal(rng));
    }
  }
};

double LineError(const Vector3d& point, const Vector3d& on_line, const Vector3d& direction) {
  return direction.cross(point - on_line).norm();
}

// +1 or -1: how the solver's axis points relative to the rig's.
double Sign(const Rig& rig, const TurntableSolution& solution) {
  return rig.axis_in_world.dot(solution.groups[0].axis_in_world) > 0 ? 1 : -1;
}

void ExpectExact(const Rig& rig, const TurntableSolution& solution, double tolerance) {
  ASSERT_EQ(solution.motion, TurntableMotion::kRotates);
  ASSERT_EQ(solution.groups.size(), 1u);
  const TurntableGroup& group = solution.groups[0];
  const double sign = Sign(rig, solution);
  EXPECT_LT((sign * group.axis_in_world - rig.axis_in_world).norm(), tolerance);
  EXPECT_LT((sign * group.axis_in_object - rig.axis_in_object).norm(), tolerance);
  EXPECT_NEAR(solution.scale, rig.scale, tolerance);
  EXPECT_LT(LineError(group.point_in_world, rig.point_in_world, rig.axis_in_world), tolerance);
  EXPECT_LT(LineError(group.point_in_object, rig.point_in_object, rig.axis_in_object), tolerance);
  for (int i = 0; i < static_cast<int>(rig.poses.size()); ++i) {
    const double expected = sign * (i % rig.steps) * rig.step_deg * kDegree;
    ASSERT_NEAR(WrapAngle(solution.images[i].angle_rad - expected), 0, tolerance) << i;
    ASSERT_TRUE(solution.images[i].inlier);
    // (1) holds for every image: the fitted motion takes the object's camera to the background's.
    const Sim3 world_from_object = WorldFromObjectAtAngle(solution, 0, solution.images[i].angle_rad);
    ASSERT_LT((world_from_object * CameraCentre(rig.poses[i].cam_from_object) -
               CameraCentre(rig.poses[i].cam_from_world))
                  .norm(),
              10 * tolerance);
  }
}

TEST(Turntable, ExactPosesGiveTheExactTurntable) {
  for (int stations = 2; stations <= 6; ++stations) {
    for (const int steps : {3, 5, 20, 72}) {
      for (const double step : {2.0, 18.0, 120.0}) {
        for (const double tilt : {0.0, 25.0}) {
          Rig rig;
          rig.stations = stations;
          rig.steps = steps;
          rig.step_deg = step;
          rig.tilt_deg = tilt;
          rig.roll_deg = stations == 3 ? 90 : 0;
          rig.Build(static_cast<uint32_t>(stations * 100 + steps));
          SCOPED_TRACE(testing::Message() << stations << " stations, " << steps << " steps of " << step);
          TurntableOptions options;
          options.max_seeds = 50;
          const TurntableSolution solution = SolveTurntable(rig.poses, options);
          ExpectExact(rig, solution, 1e-9);  // measured 1e-12 at 3 steps of 2 degrees, else below 1e-13
          EXPECT_TRUE(solution.scale_observable);
          EXPECT_EQ(solution.num_distinct_stations, stations);
          if (step < 60) {
            EXPECT_NEAR(std::abs(solution.median_step_deg), step, 1e-8);
          }
        }
      }
    }
  }
}

TEST(Turntable, AxisPointsToWhereTheCamerasAre) {
  Rig rig;
  rig.tilt_deg = 20;
  rig.Build(5);
  EXPECT_EQ(Sign(rig, SolveTurntable(rig.poses)), 1);
  // Level cameras: the images' tops decide.
  Rig level;
  level.elevation_step_deg = 0;
  level.azimuth_step_deg = 25;
  level.Build(6);
  for (TurntablePose& pose : level.poses) {  // pitch the cameras until they look level
    const Rigid3 pitch{Eigen::Quaterniond(Eigen::AngleAxisd(-15 * kDegree, Vector3d::UnitX())),
                       Vector3d::Zero()};
    pose.cam_from_object = pitch * pose.cam_from_object;
    pose.cam_from_world = pitch * pose.cam_from_world;
  }
  EXPECT_EQ(Sign(level, SolveTurntable(level.poses)), 1);
}

TEST(Turntable, SenseFollowsTheTable) {
  Rig rig;
  rig.step_deg = 18;
  rig.Build(7);
  EXPECT_EQ(SolveTurntable(rig.poses).sense, 1);
  rig.step_deg = -18;
  rig.Build(7);
  const TurntableSolution back = SolveTurntable(rig.poses);
  EXPECT_EQ(back.sense, -1);
  EXPECT_NEAR(back.median_step_deg, -18, 1e-9);
}

TEST(Turntable, ThirtyPercentWrongPosesDoNoHarm) {
  for (uint32_t seed = 0; seed < 20; ++seed) {
    Rig rig;
    rig.stations = 2 + static_cast<int>(seed % 4);
    rig.steps = 20;
    rig.step_deg = 18;
    rig.Build(seed);
    std::vector<bool> spoiled;
    rig.Spoil(0.3, seed, &spoiled);
    TurntableOptions options;
    options.max_seeds = 200;
    const TurntableSolution solution = SolveTurntable(rig.poses, options);
    ASSERT_EQ(solution.motion, TurntableMotion::kRotates);
    ASSERT_EQ(solution.groups.size(), 1u) << seed;
    EXPECT_NEAR(solution.scale, rig.scale, 1e-9) << seed;
    EXPECT_LT((solution.groups[0].axis_in_world - rig.axis_in_world).norm(), 1e-9);
    for (size_t i = 0; i < rig.poses.size(); ++i) EXPECT_EQ(solution.images[i].inlier, !spoiled[i]) << i;
  }
}

// Predicted standard deviations against the scatter over seeds.
TEST(Turntable, SigmasPredictTheErrors) {
  for (const double noise : {1e-4, 1e-3}) {
    for (const bool shared : {false, true}) {
      double axis = 0;
      double scale = 0;
      double point = 0;
      double angle = 0;
      const int seeds = 60;
      int angles = 0;
      for (uint32_t seed = 0; seed < seeds; ++seed) {
        Rig rig;
        rig.steps = 20;
        rig.step_deg = 18;
        rig.rotation_noise_deg = noise * 50;
        rig.centre_noise = noise;
        rig.station_noise = shared ? 3 * noise : 0;
        rig.Build(seed);
        TurntableOptions options;
        options.max_seeds = 50;
        const TurntableSolution solution = SolveTurntable(rig.poses, options);
        ASSERT_EQ(solution.motion, TurntableMotion::kRotates);
        const auto square = [](double x) { return x * x; };
        axis += square((solution.groups[0].axis_in_world - rig.axis_in_world).norm() / kDegree /
                       solution.axis_sigma_deg);
        scale += square((solution.scale / rig.scale - 1) / solution.scale_sigma_rel);
        point += square(LineError(solution.groups[0].point_in_world, rig.point_in_world, rig.axis_in_world) /
                        solution.point_sigma);
        for (size_t i = 1; i < rig.poses.size(); ++i) {
          if (!solution.images[i].inlier) continue;
          const double expected = static_cast<double>(i % 20) * rig.step_deg * kDegree;
          angle += square(WrapAngle(solution.images[i].angle_rad - expected) / kDegree /
                          solution.rotation_sigma_deg);
          ++angles;
        }
      }
      SCOPED_TRACE(testing::Message() << "noise " << noise << ", shared " << shared);
      EXPECT_GT(angles, 0.99 * 59 * seeds);
      // Two coordinates at most one sigma each: at most sqrt(2); one coordinate: 1; differences: sqrt(2).
      EXPECT_THAT(std::sqrt(axis / seeds), testing::AllOf(testing::Ge(0.7), testing::Le(1.7)));
      EXPECT_THAT(std::sqrt(scale / seeds), testing::AllOf(testing::Ge(0.7), testing::Le(1.6)));
      EXPECT_THAT(std::sqrt(point / seeds), testing::AllOf(testing::Ge(0.5), testing::Le(2.0)));
      EXPECT_THAT(std::sqrt(angle / angles), testing::AllOf(testing::Ge(1.0), testing::Le(1.8)));
    }
  }
}

// sigma_lambda / lambda is about sigma_C / |C_1 - C_2|: halving the baseline doubles it.
TEST(Turntable, ScaleSigmaGoesWithTheBaseline) {
  const auto sigma = [](double elevation_step) {
    double sum = 0;
    for (uint32_t seed = 0; seed < 20; ++seed) {
      Rig rig;
      rig.stations = 2;
      rig.steps = 20;
      rig.step_deg = 18;
      rig.elevation_step_deg = elevation_step;
      rig.centre_noise = 2e-4;
      rig.Build(seed);
      sum += SolveTurntable(rig.poses).scale_sigma_rel;
    }
    return sum / 20;
  };
  const double wide = sigma(20);
  const double narrow = sigma(5);
  const double ratio = std::sin(10 * kDegree) / std::sin(2.5 * kDegree);  // of the baselines
  EXPECT_NEAR(narrow / wide, ratio, 0.2 * ratio);
  // 20 images a station: sigma_C = 2e-4 sqrt(2 / 20) for the difference of two means.
  EXPECT_NEAR(wide / (2e-4 * std::sqrt(2.0 / 20) / (2 * std::sin(10 * kDegree))), 1, 0.25);
}

TEST(Turntable, PurelyVerticalMotionOfTheCameraFixesTheScale) {
  Rig rig;
  rig.stations = 2;
  rig.Build(3);
  for (size_t i = 0; i < rig.poses.size(); ++i) {
    if (rig.poses[i].station == 0) continue;
    // Station 1 becomes station 0 moved along the axis, in both reconstructions.
    const TurntablePose& low = rig.poses[i - static_cast<size_t>(rig.steps)];
    const double lift = 0.4;
    TurntablePose& high = rig.poses[i];
    high.cam_from_world.rotation = low.cam_from_world.rotation;
    high.cam_from_world.translation =
        -(high.cam_from_world.rotation *
          (CameraCentre(low.cam_from_world) + rig.scale * lift * rig.axis_in_world));
    high.cam_from_object.rotation = low.cam_from_object.rotation;
    high.cam_from_object.translation =
        -(high.cam_from_object.rotation * (CameraCentre(low.cam_from_object) + lift * rig.axis_in_object));
  }
  const TurntableSolution solution = SolveTurntable(rig.poses);
  EXPECT_TRUE(solution.scale_observable);
  EXPECT_NEAR(solution.scale, rig.scale, 1e-9);
}

TEST(Turntable, OneStationHasNoScale) {
  for (const double noise : {0.0, 1e-3}) {
    for (const double shake : {0.0, 1e-4}) {
      Rig rig;
      rig.stations = 1;
      rig.steps = 36;
      rig.step_deg = 10;
      rig.scale = 1;
      rig.rotation_noise_deg = 50 * noise;
      rig.centre_noise = noise;
      rig.Build(11);
      std::mt19937 rng(1);
      std::normal_distribution<double> normal;
      for (TurntablePose& pose : rig.poses) {
        pose.cam_from_world.translation += shake * Vector3d(normal(rng), normal(rng), normal(rng));
      }
      const TurntableSolution solution = SolveTurntable(rig.poses);
      SCOPED_TRACE(testing::Message() << "noise " << noise << ", shake " << shake);
      ASSERT_EQ(solution.motion, TurntableMotion::kRotates);
      EXPECT_FALSE(solution.scale_observable);
      EXPECT_EQ(solution.scale, 1);
      EXPECT_EQ(solution.num_distinct_stations, 1);
      const double tolerance = noise == 0 && shake == 0 ? 1e-9 : 5e-3;
      EXPECT_LT((solution.groups[0].axis_in_world - rig.axis_in_world).norm(), tolerance);
      EXPECT_LT(LineError(solution.groups[0].point_in_world, rig.point_in_world, rig.axis_in_world),
                tolerance);
      if (noise == 0 && shake == 0) {
        EXPECT_EQ(solution.scale_singular_gap, 0);
      }
    }
  }
}

// Stations that differ by orientation alone have no baseline.
TEST(Turntable, ZeroBaselineIsReportedAsNoScale) {
  Rig rig;
  rig.stations = 2;
  rig.elevation_step_deg = 0;
  rig.scale = 1;
  rig.Build(12);
  const Rigid3 pan{Eigen::Quaterniond(Eigen::AngleAxisd(0.2, Vector3d::UnitY())), Vector3d::Zero()};
  for (TurntablePose& pose : rig.poses) {
    if (pose.station == 0) continue;
    pose.cam_from_object = pan * pose.cam_from_object;
    pose.cam_from_world = pan * pose.cam_from_world;
  }
  const TurntableSolution solution = SolveTurntable(rig.poses);
  ASSERT_EQ(solution.motion, TurntableMotion::kRotates);
  EXPECT_FALSE(solution.scale_observable);
  EXPECT_EQ(solution.scale_singular_gap, 0);
  EXPECT_EQ(solution.num_distinct_stations, 1);
}

TEST(Turntable, NothingRotatesIsNamed) {
  for (const double noise : {0.0, 1e-4, 1e-3}) {
    for (const int steps : {2, 4, 20}) {
      for (uint32_t seed = 0; seed < 20; ++seed) {
        Rig rig;
        rig.step_deg = 0;
        rig.steps = steps;
        rig.rotation_noise_deg = 50 * noise;
        rig.centre_noise = noise;
        rig.Build(seed);
        const TurntableSolution solution = SolveTurntable(rig.poses);
        // Six images cannot always tell a turn within the noise from none.
        if (steps == 2 && solution.motion == TurntableMotion::kStepsTooSmall) continue;
        ASSERT_EQ(solution.motion, TurntableMotion::kNothingRotates) << noise << " " << steps << " " << seed;
        ASSERT_TRUE(solution.groups.empty());
      }
    }
  }
}

TEST(Turntable, StepsTooSmallAreNamed) {
  Rig rig;
  rig.stations = 1;
  rig.steps = 12;
  rig.step_deg = 0.13;
  rig.rotation_noise_deg = 0.1;
  rig.Build(14);
  const TurntableSolution solution = SolveTurntable(rig.poses);
  EXPECT_EQ(solution.motion, TurntableMotion::kStepsTooSmall) << TurntableMotionName(solution.motion);
  EXPECT_GT(solution.axis_sigma_deg, 3);
}

TEST(Turntable, TooFewImagesAreNamed) {
  EXPECT_EQ(SolveTurntable({}).motion, TurntableMotion::kTooFewImages);
  Rig rig;
  rig.Build(15);
  rig.poses.resize(1);
  EXPECT_EQ(SolveTurntable(rig.poses).motion, TurntableMotion::kTooFewImages);
  rig.Build(15);
  rig.poses.resize(2);
  const TurntableSolution two = SolveTurntable(rig.poses);  // just enough for an axis, one station
  EXPECT_EQ(two.motion, TurntableMotion::kRotates);
  EXPECT_FALSE(two.scale_observable);
}

TEST(Turntable, NonFinitePosesAreOutliers) {
  Rig rig;
  rig.Build(16);
  rig.poses[4].cam_from_object.translation.x() = std::numeric_limits<double>::quiet_NaN();
  rig.poses[9].cam_from_world.rotation.coeffs() *= std::numeric_limits<double>::infinity();
  const TurntableSolution solution = SolveTurntable(rig.poses);
  ASSERT_EQ(solution.motion, TurntableMotion::kRotates);
  EXPECT_FALSE(solution.images[4].inlier);
  EXPECT_FALSE(solution.images[9].inlier);
  EXPECT_NEAR(solution.scale, rig.scale, 1e-9);
}

// The object was turned over, or only pushed, for the second half of each station's images.
TEST(Turntable, ObjectThatWasMovedBetweenRoundsMakesTwoGroups) {
  for (const bool turned_over : {true, false}) {
    Rig rig;
    rig.steps = 20;
    rig.step_deg = 18;
    rig.rotation_noise_deg = 0.02;
    rig.centre_noise = 2e-4;
    rig.Build(17);
    Rigid3 move;  // in the object's frame
    move.translation = Vector3d(0.2, -0.1, 0.15);
    if (turned_over)
      move.rotation = Eigen::Quaterniond(Eigen::AngleAxisd(2.8, Vector3d(1, 2, 0.3).normalized()));
    for (size_t i = 0; i < rig.poses.size(); ++i) {
      if (i % 20 >= 12) rig.poses[i].cam_from_object = rig.poses[i].cam_from_object * move;
    }
    const TurntableSolution solution = SolveTurntable(rig.poses);
    ASSERT_EQ(solution.motion, TurntableMotion::kRotates);
    ASSERT_EQ(solution.groups.size(), 2u) << turned_over;
    EXPECT_EQ(solution.groups[0].num_images, 36);
    EXPECT_EQ(solution.groups[1].num_images, 24);
    for (size_t i = 0; i < rig.poses.size(); ++i) EXPECT_EQ(solution.images[i].group, i % 20 >= 12 ? 1 : 0);
    EXPECT_NEAR(solution.scale, rig.scale, 1e-3);
    EXPECT_LT((solution.groups[1].axis_in_world - rig.axis_in_world).norm(), 1e-3);
  }
}

TEST(Turntable, OptionsAreChecked) {
  TurntableOptions options;
  EXPECT_FALSE(options.Check());
  options.inlier_sigmas = 0;
  EXPECT_EQ(options.Check()->field, "inlier_sigmas");
}

}  // namespace
}  // namespace s2gs
