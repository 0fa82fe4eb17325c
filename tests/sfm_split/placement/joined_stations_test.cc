#include "sfm_split/placement/joined_stations.h"

#include <gtest/gtest.h>

#include <map>
#include <set>
#include <vector>

#include "tests/support/synthetic_scan.h"
#include "tests/support/synthetic_turntable.h"

namespace s2gs {
namespace {

SyntheticTurntableOptions TwoStations() {
  SyntheticTurntableOptions options;
  options.stations = 2;
  options.steps = 12;
  options.step_deg = 30;
  options.num_object_points = 20;
  options.num_platter_points = 0;
  options.num_background_points = 0;
  options.shake_deg = 0.1;
  return options;
}

// Photos that a plain wall leaves by themselves.
void Lose(const std::set<size_t>& images, ScanFeatures* features) {
  int next = 100;
  for (const size_t image : images) features->images[image].station = next++;
}

std::set<size_t> Range(size_t from, size_t to) {
  std::set<size_t> range;
  for (size_t i = from; i < to; ++i) range.insert(i);
  return range;
}

// Sets of images.
std::set<std::set<size_t>> Partition(const std::vector<int>& stations) {
  std::map<int, std::set<size_t>> of_station;
  for (size_t i = 0; i < stations.size(); ++i) of_station[stations[i]].insert(i);
  std::set<std::set<size_t>> partition;
  for (const auto& [station, images] : of_station) partition.insert(images);
  return partition;
}

TEST(StationsByPoses, PhotosOfOnePlaceAreJoined) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(TwoStations());
  ScanFeatures features = SyntheticScanFeatures(turntable);
  std::set<size_t> lost = Range(12, 24);
  lost.insert(3);
  Lose(lost, &features);
  const auto stations = StationsByPoses(features, turntable.scene);
  ASSERT_TRUE(stations);
  EXPECT_EQ(Partition(*stations), (std::set<std::set<size_t>>{Range(0, 12), Range(12, 24)}));
}

TEST(StationsByPoses, WhereStationsAreWholeNothingChanges) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(TwoStations());
  EXPECT_FALSE(StationsByPoses(SyntheticScanFeatures(turntable), turntable.scene));
}

TEST(StationsByPoses, FewPhotosMakeNoPlace) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(TwoStations());
  ScanFeatures features = SyntheticScanFeatures(turntable);
  Lose(Range(12, 24), &features);
  TurntableScene scene = turntable.scene;
  scene.views.erase(scene.views.begin() + 17, scene.views.end());
  EXPECT_FALSE(StationsByPoses(features, scene));
}

TEST(StationsByPoses, ACameraInTheHandStandsNowhereTwice) {
  SyntheticTurntableOptions options = TwoStations();
  options.hand_held = true;
  options.steps = 24;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  ScanFeatures features = SyntheticScanFeatures(turntable);
  Lose(Range(0, features.images.size()), &features);
  EXPECT_FALSE(StationsByPoses(features, turntable.scene));
}

// Which of two places that are nearer to each other than a plate may wobble by a photo is of.
TEST(StationsByPoses, BetweenTwoPlacesNothingIsTold) {
  SyntheticTurntableOptions options = TwoStations();
  options.steps = 14;
  options.step_deg = 25;
  options.shake_deg = 0;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  ScanFeatures features = SyntheticScanFeatures(turntable);
  Lose({3}, &features);
  for (size_t i = 7; i < 14; ++i) features.images[i].station = 7;
  EXPECT_FALSE(StationsByPoses(features, turntable.scene));
}

}  // namespace
}  // namespace s2gs
