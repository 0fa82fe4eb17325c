#include "sfm_split/relocalise/station_turns.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <map>
#include <utility>
#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/relocalise/match_ascent.h"
#include "sfm_split/relocalise/station_witnesses.h"
#include "sfm_split/scene/axis_turn.h"
#include "tests/support/synthetic_models.h"
#include "tests/support/synthetic_scan.h"

namespace s2gs {
namespace {

SyntheticTurntable MakeScan(uint64_t seed, double outlier_share = 0.3) {
  SyntheticTurntableOptions options;
  options.stations = 2;
  options.steps = 12;
  options.step_deg = 30;
  options.num_object_points = 60;
  options.num_platter_points = 0;
  options.num_background_points = 150;
  options.max_view_change_deg = 60;
  options.pixel_noise = 0.3;
  options.dropout = 0.1;
  options.outlier_share = outlier_share;
  options.seed = seed;
  return MakeSyntheticTurntable(options);
}

AlignedScene Truth(const SyntheticTurntable& turntable) {
  AlignedScene aligned;
  aligned.scene = turntable.scene;
  aligned.background = SyntheticStaticModel(turntable);
  return aligned;
}

bool IsCrossing(const ScanFeatures& features, int image1, int image2) {
  return features.images[static_cast<size_t>(image1)].station !=
         features.images[static_cast<size_t>(image2)].station;
}

// Each match takes the next one's second keypoint.
void MakeWrong(FeatureMatches* matches) {
  if (matches->size() < 2) matches->clear();
  for (size_t m = 0; m + 1 < matches->size(); ++m)
    std::swap((*matches)[m].point2D_idx2, (*matches)[m + 1].point2D_idx2);
}

StationTurns Ask(const ScanFeatures& features, const AlignedScene& aligned) {
  Reporter reporter;
  return AskStationTurns(features, PossibleObjectPairs(features, false), aligned, reporter);
}

// The standard deviation is that of where the top lies: over scans that differ in their noise alone.
TEST(StationTurns, SigmaIsTheSpreadOfTheTop) {
  double squares = 0;
  double variances = 0;
  constexpr int kScans = 12;
  for (int scan = 0; scan < kScans; ++scan) {
    const SyntheticTurntable turntable = MakeScan(static_cast<uint64_t>(scan) + 1);
    const ScanFeatures features = SyntheticScanFeatures(turntable);
    const AlignedScene aligned = Truth(turntable);
    const StationTurns turns = Ask(features, aligned);
    ASSERT_EQ(turns.sigma_deg.size(), 1U);
    const double sigma_deg = turns.sigma_deg.at(1);
    ASSERT_TRUE(std::isfinite(sigma_deg)) << scan;
    variances += sigma_deg * sigma_deg;
    EXPECT_LT(turns.overdispersion, 3) << scan;
    MatchAscent ascent(features, StationWitnesses(features, aligned, PossibleObjectPairs(features, false)),
                       aligned);
    Reporter reporter;
    ascent.Settle({0.3, 0.3}, reporter);
    const auto& stations = ascent.state().stations;
    const double off_deg = (stations[1].turn_rad - stations[0].turn_rad) / kDegree;
    squares += off_deg * off_deg;
  }
  const double spread_deg = std::sqrt(squares / kScans);
  const double stated_deg = std::sqrt(variances / kScans);
  RecordProperty("spread_deg", std::to_string(spread_deg));
  RecordProperty("stated_deg", std::to_string(stated_deg));
  // Twelve scans tell their spread to a fifth.
  EXPECT_LT(spread_deg, 1.5 * stated_deg) << stated_deg;
  EXPECT_GT(spread_deg, stated_deg / 3) << stated_deg;
}

TEST(StationTurns, WrongMatchesBetweenStationsTellNothing) {
  const SyntheticTurntable turntable = MakeScan(1);
  ScanFeatures features = SyntheticScanFeatures(turntable);
  for (auto* pairs : {&features.object_pairs, &features.raw_pairs}) {
    for (ImagePairMatches& pair : *pairs) {
      if (!IsCrossing(features, pair.image1, pair.image2)) continue;
      MakeWrong(&pair.matches);
    }
  }
  EXPECT_GT(Ask(features, Truth(turntable)).sigma_deg.at(1), 1);
}

// Adjusted poses that lie far below the top in likelihood say that its logarithms are too large.
TEST(StationTurns, PosesBelowTheTopWidenIt) {
  const SyntheticTurntable turntable = MakeScan(1);
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  AlignedScene aligned = Truth(turntable);
  const StationTurns at_truth = Ask(features, aligned);
  const Rigid3 moved{Eigen::Quaterniond(ExpRotation<double>(Eigen::Vector3d(0.002, -0.002, 0.001))),
                     Eigen::Vector3d::Zero()};
  for (View& view : aligned.scene.views) {
    if (view.station == 1) view.cam_from_world = moved * view.cam_from_world;
  }
  const StationTurns beside = Ask(features, aligned);
  EXPECT_GT(beside.overdispersion, 3 * at_truth.overdispersion);
  EXPECT_GT(beside.sigma_deg.at(1), 1.5 * at_truth.sigma_deg.at(1));
}

// Nothing says how the cameras stand, and yet the object's matches tell how they stand to it.
TEST(StationTurns, WithoutABackgroundTheObjectTellsHowItStands) {
  const SyntheticTurntable turntable = MakeScan(1);
  ScanFeatures features = SyntheticScanFeatures(turntable);
  AlignedScene aligned = Truth(turntable);
  aligned.background = ColmapModel();
  const StationTurns turns = Ask(features, aligned);
  EXPECT_LT(turns.sigma_deg.at(1), 0.3);  // .144 is measured, .100 with the background
  EXPECT_GT(turns.sigma_deg.at(1), 0.02);
  // The second station's cameras, turned about the axis by three degrees against their photos' angles.
  const Rigid3 turned = TurnAbout(aligned.scene.axis, 3 * kDegree);
  for (View& view : aligned.scene.views) {
    if (view.station == 1) view.cam_from_world = view.cam_from_world * turned;
  }
  EXPECT_GT(Ask(features, aligned).overdispersion, 10);
  for (auto* pairs : {&features.object_pairs, &features.raw_pairs}) {
    for (ImagePairMatches& pair : *pairs) {
      if (IsCrossing(features, pair.image1, pair.image2)) MakeWrong(&pair.matches);
    }
  }
  EXPECT_GT(Ask(features, aligned).sigma_deg.at(1), 1);
}

TEST(StationTurns, OneStationSaysNothing) {
  SyntheticTurntableOptions options;
  options.stations = 1;
  options.steps = 12;
  options.step_deg = 30;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  AlignedScene aligned;
  aligned.scene = turntable.scene;
  EXPECT_TRUE(Ask(features, aligned).sigma_deg.empty());
  EXPECT_EQ(Ask(features, aligned).overdispersion, 1);
}

TEST(StationTurns, AnglesAreNoSurerThanTheirStations) {
  const SyntheticTurntable turntable = MakeScan(1);
  const TurntableScene& scene = turntable.scene;
  JointReport joint;
  for (const View& view : scene.views) joint.angle_sigma_deg.push_back(view.angle_deg == 0 ? 0 : 0.01);
  StationTurns turns;
  turns.sigma_deg[1] = 0.4;
  WidenByTurns(scene, turns, &joint);
  for (size_t v = 0; v < scene.views.size(); ++v) {
    const double before = scene.views[v].angle_deg == 0 ? 0 : 0.01;
    EXPECT_EQ(joint.angle_sigma_deg[v], scene.views[v].station == 1 && before > 0 ? 0.4 : before) << v;
  }
}

// All matches of a detail weigh one; those that stand still are likelier wrong than others.
TEST(StationWitnesses, ADetailIsOneAndWhatStandsIsLikelierWrong) {
  const SyntheticTurntable turntable = MakeScan(1, 0);
  ScanFeatures features = SyntheticScanFeatures(turntable);
  const AlignedScene aligned = Truth(turntable);
  const std::vector<PossiblePair> given = PossibleObjectPairs(features, false);
  double weights = 0;
  size_t matches = 0;
  for (const PossiblePair& pair : StationWitnesses(features, aligned, given)) {
    if (!IsCrossing(features, pair.image1, pair.image2)) continue;
    for (const double weight : pair.weight) weights += weight;
    matches += pair.matches.size();
  }
  // A detail is a point at most, and a point is several where no photos connect its matches.
  EXPECT_GE(weights, 1);
  EXPECT_LT(weights, 2 * 60);
  EXPECT_GT(static_cast<double>(matches), 3 * weights);
}

}  // namespace
}  // namespace s2gs
