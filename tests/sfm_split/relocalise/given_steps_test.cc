// Equal steps that an adjustment is told hold the table's angles; without them angles follow the keypoints.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "tests/sfm_split/relocalise/small_scan.h"

namespace s2gs {
namespace {

// How far the angles of a station's photos lie from equal steps of 30 degrees, at most [deg].
double OffEqualStepsDeg(const AlignedScene& aligned) {
  std::map<int, std::vector<double>> angles_of_station;
  for (const View& view : aligned.scene.views) {
    const Eigen::Quaterniond& q = view.world_from_object.rotation;
    angles_of_station[view.station].push_back(2 *
                                              std::atan2(q.vec().dot(aligned.scene.axis.direction), q.w()));
  }
  double worst = 0;
  for (const auto& [station, angles] : angles_of_station) {
    for (size_t i = 1; i < angles.size(); ++i) {
      const double turn = WrapAngle(angles[i] - angles[0]) / kDegree;
      worst = std::max(worst, std::abs(turn - 30 * std::round(turn / 30)));
    }
  }
  return worst;
}

TEST(GivenSteps, HoldTheAnglesOfATableThatTurnsUnevenly) {
  SyntheticTurntableOptions options = SmallScan();
  options.step_jitter = 0.02;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  const ColmapModel object = SyntheticObjectModel(turntable);
  const ColmapModel background = SyntheticStaticModel(turntable);
  const auto refined = [&](const RefineOptions& refine) {
    AlignedScene aligned = AlignScene(object, &background, StationsOf(features));
    JointOptions joint;
    joint.model = JointModel::kSharedStations;
    Reporter reporter;
    RefineScan(features, &object, joint, refine, reporter, &aligned);
    return OffEqualStepsDeg(aligned);
  };
  EXPECT_GT(refined({}), 0.1);

  RefineOptions told;
  std::map<int, EqualStepsPrior> steps;
  for (size_t i = 0; i < features.images.size(); ++i) {
    EqualStepsPrior& prior = steps[features.images[i].station];
    prior.places.push_back({static_cast<int>(i), static_cast<double>(prior.places.size())});
    prior.step_rad = 30 * kDegree;
    prior.sigma_rad = 1e-3 * kDegree;
  }
  for (const auto& [station, prior] : steps) told.equal_steps.push_back(prior);
  EXPECT_LT(refined(told), 0.03);
}

}  // namespace
}  // namespace s2gs
