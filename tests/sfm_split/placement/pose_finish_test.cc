// When the surface between keypoints is asked: photos are read once more then. They show nothing, so that no
// pose moves.
#include "sfm_split/placement/pose_finish.h"

#include <gtest/gtest.h>

#include <atomic>
#include <limits>
#include <map>
#include <string>
#include <vector>

#include "tests/support/synthetic_models.h"
#include "tests/support/synthetic_scan.h"

namespace s2gs {
namespace {

constexpr double kSureDeg = 0.05;

class PoseFinishTest : public testing::Test {
 protected:
  PoseFinishTest() {
    SyntheticTurntableOptions options;
    options.stations = 1;
    options.steps = 12;
    options.step_deg = 30;
    options.num_object_points = 60;
    options.num_background_points = 0;
    options.width = 160;
    options.height = 120;
    turntable_ = MakeSyntheticTurntable(options);
    features_ = SyntheticScanFeatures(turntable_);
  }

  // How often photos are read where the adjustment states these standard deviations.
  int NumReads(double axis_deg, const std::vector<double>& angles_deg) const {
    ScanPlacement result;
    result.best.is_usable = true;
    result.best.aligned = AlignScene(SyntheticObjectModel(turntable_), nullptr, StationsOf(features_));
    result.best.refined.model = JointModel::kSharedStations;
    result.best.refined.joint.sigma_px = 0.3;
    result.best.refined.joint.axis_direction_sigma_deg = axis_deg;
    result.best.refined.joint.angle_sigma_deg = angles_deg;
    Reporter reporter;
    const PlacementOptions options;
    const CandidateLikelihood likelihood(features_);
    const CircleRefinement circles(features_, likelihood, options.refine, options.joint, reporter);
    Stopwatch watch;
    std::atomic<int> num_reads = 0;
    PoseFinish finish(features_, likelihood, circles, options, reporter, &watch, &result);
    finish.FinishWithoutSilhouettes([&](const std::string& /*name*/) {
      ++num_reads;
      return GreyPhoto{160, 120, std::vector<uint8_t>(size_t{160} * 120, 128)};
    });
    EXPECT_FALSE(result.photos.is_taken);
    return num_reads;
  }

  std::vector<double> Angles(double sigma_deg) const {
    return std::vector<double>(turntable_.scene.views.size(), sigma_deg);
  }

  SyntheticTurntable turntable_;
  ScanFeatures features_;
};

TEST_F(PoseFinishTest, TheSurfaceIsAskedWherePosesAreNotSure) {
  const int when_sure = NumReads(0.9 * kSureDeg, Angles(0.9 * kSureDeg));
  EXPECT_GT(NumReads(1.1 * kSureDeg, Angles(0.9 * kSureDeg)), when_sure);
  EXPECT_GT(NumReads(0.9 * kSureDeg, Angles(1.1 * kSureDeg)), when_sure);
}

TEST_F(PoseFinishTest, WhatIsNotKnownIsNotSure) {
  const int when_sure = NumReads(0.9 * kSureDeg, Angles(0.9 * kSureDeg));
  EXPECT_GT(NumReads(-1, Angles(0.9 * kSureDeg)), when_sure);
  EXPECT_GT(NumReads(0.9 * kSureDeg, Angles(-1)), when_sure);
  EXPECT_GT(NumReads(0.9 * kSureDeg, Angles(std::numeric_limits<double>::infinity())), when_sure);
  // The reference's angle has no deviation; half of the others may be worse than that.
  std::vector<double> most = Angles(0.9 * kSureDeg);
  most[0] = 0;
  for (size_t i = 1; i < most.size(); i += 3) most[i] = 1;
  EXPECT_EQ(NumReads(0.9 * kSureDeg, most), when_sure);
}

// Before a plain wall nothing ties the table's angle at one station to that at another.
TEST(TurnsByPatches, AreThoseOfTheObjectWhereNothingTiesTheTable) {
  TurntableScene scene;
  JointReport joint;
  for (const int station : {0, 0, 1, 1, 2, 2}) {
    View view;
    view.station = station;
    scene.views.push_back(view);
    joint.angle_sigma_deg.push_back(station == 1 ? std::numeric_limits<double>::infinity() : 0.1);
    joint.turn_sigma_deg.push_back(0.2);
  }
  joint.angle_sigma_deg[0] = joint.turn_sigma_deg[0] = 0;  // the reference's
  joint.turn_sigma_deg[3] = 0.3;
  EXPECT_EQ(TurnsByPatches(scene, joint, {0, 1}), (std::map<int, double>{{0, 0.1}, {1, 0.3}}));
}

}  // namespace
}  // namespace s2gs
