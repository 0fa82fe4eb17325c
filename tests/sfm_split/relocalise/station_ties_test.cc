#include "sfm_split/relocalise/station_ties.h"

#include <gtest/gtest.h>

#include <random>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "tests/support/synthetic_scan.h"

namespace s2gs {
namespace {

// The true cameras of the stations' first images, each station turned about the axis by `turned_deg`.
std::vector<StationMatches> TurnedMatches(const SyntheticTurntable& turntable, const ScanFeatures& features,
                                          const std::vector<double>& turned_deg, double wrong_share) {
  const TurntableAxis& axis = turntable.scene.axis;
  std::vector<StationMatches> pairs;
  for (const ImagePairMatches& pair : features.static_pairs) {
    const auto i = static_cast<size_t>(pair.image1);
    const auto j = static_cast<size_t>(pair.image2);
    const auto pose = [&](size_t image) {
      const Eigen::Matrix3d turn = RotationAbout<double>(
          axis.direction, -turned_deg[static_cast<size_t>(features.images[image].station)] * kDegree);
      return turntable.scene.views[image].cam_from_world *
             Rigid3{Eigen::Quaterniond(turn), axis.point - turn * axis.point};
    };
    StationMatches all;
    all.station = features.images[i].station;
    all.other_station = features.images[j].station;
    double wrong = 0;
    for (const FeatureMatch& match : pair.matches) {
      MatchAcrossTurn across{&turntable.CameraOf(pair.image1),
                             pose(i),
                             features.images[i].keypoints[match.point2D_idx1].cast<double>(),
                             &turntable.CameraOf(pair.image2),
                             pose(j),
                             features.images[j].keypoints[match.point2D_idx2].cast<double>()};
      wrong += wrong_share;
      if (wrong >= 1) {
        wrong -= 1;
        across.xy = Eigen::Vector2d(640, 480) - across.xy;
      }
      all.matches.push_back(across);
    }
    pairs.push_back(std::move(all));
  }
  return pairs;
}

SyntheticTurntableOptions FourStations() {
  SyntheticTurntableOptions options;
  options.stations = 4;
  options.steps = 3;
  options.num_background_points = 60;
  options.pixel_noise = 0.5;
  return options;
}

TEST(StationTies, EachStationsAngleIsFoundFromMatchesAlone) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(FourStations());
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  const std::vector<double> turned = {0, 2.3, -140, 71};
  for (const double wrong_share : {0.0, 0.4}) {
    const std::vector<StationTie> ties =
        TieStations(4, 0, turntable.scene.axis, TurnedMatches(turntable, features, turned, wrong_share), {});
    for (size_t s = 0; s < ties.size(); ++s) {
      EXPECT_EQ(ties[s].component, 0);
      // Measured 0.19 degrees at most: half a pixel of noise, by few matches at this distance.
      EXPECT_LT(std::abs(WrapAngle(ties[s].turn_rad - turned[s] * kDegree)) / kDegree, 0.5) << s;
    }
  }
}

TEST(StationTies, StationsThatStandRightStay) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(FourStations());
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  for (const StationTie& tie :
       TieStations(4, 2, turntable.scene.axis, TurnedMatches(turntable, features, {0, 0, 0, 0}, 0.2), {})) {
    EXPECT_EQ(tie.component, 2);
    EXPECT_EQ(tie.turn_rad, 0);
  }
}

TEST(StationTies, WhatNothingTiesStaysApart) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(FourStations());
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  std::vector<StationMatches> pairs = TurnedMatches(turntable, features, {0, 10, 0, 10}, 0);
  for (StationMatches& pair : pairs) {
    // Between the sets {0, 1} and {2, 3} all matches are wrong.
    if (pair.station > 1 || pair.other_station < 2) continue;
    for (size_t k = 0; k < pair.matches.size(); ++k) {
      pair.matches[k].xy = {static_cast<double>(97 * k % 640), static_cast<double>(61 * k % 480)};
    }
  }
  const std::vector<StationTie> ties = TieStations(4, 0, turntable.scene.axis, pairs, {});
  EXPECT_EQ(ties[0].component, 0);
  EXPECT_EQ(ties[1].component, 0);
  EXPECT_NEAR(ties[1].turn_rad / kDegree, 10, 0.5);
  EXPECT_EQ(ties[2].component, 2);
  EXPECT_EQ(ties[3].component, 2);
}

// Nearest neighbours of which nine in ten are wrong tie a station; without right ones they tie none.
TEST(StationTies, RawMatchesTieBeyondChanceOnly) {
  SyntheticTurntableOptions options = FourStations();
  options.num_background_points = 1200;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  const std::vector<double> turned = {0, 2.3, -140, 71};
  for (const int wrong_in_ten : {9, 10}) {
    std::vector<StationMatches> pairs = TurnedMatches(turntable, features, turned, 0);
    std::mt19937 rng(5);
    std::uniform_real_distribution<double> x(0, 640);
    std::uniform_real_distribution<double> y(0, 480);
    for (StationMatches& pair : pairs) {
      pair.are_verified = false;
      for (size_t k = 0; k < pair.matches.size(); ++k) {
        if (static_cast<int>(k % 10) < wrong_in_ten) pair.matches[k].xy = {x(rng), y(rng)};
      }
    }
    const std::vector<StationTie> ties = TieStations(4, 0, turntable.scene.axis, pairs, {});
    for (size_t s = 0; s < ties.size(); ++s) {
      EXPECT_EQ(ties[s].component, wrong_in_ten == 9 ? 0 : static_cast<int>(s));
      if (wrong_in_ten == 10) continue;
      EXPECT_EQ(ties[s].by_raw_matches, s > 0);
      EXPECT_LT(std::abs(WrapAngle(ties[s].turn_rad - turned[s] * kDegree)) / kDegree, 0.5) << s;
    }
  }
}

}  // namespace
}  // namespace s2gs
