#include "sfm_split/placement/joined_stations.h"

#include <gtest/gtest.h>

#include <limits>
#include <map>
#include <set>
#include <utility>
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

// Nothing is close to it, not even itself.
TEST(StationsByPoses, APoseThatIsNoneStandsAlone) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(TwoStations());
  ScanFeatures features = SyntheticScanFeatures(turntable);
  Lose({3}, &features);
  TurntableScene scene = turntable.scene;
  scene.views[3].cam_from_world.translation.x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(StationsByPoses(features, scene));
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

TEST(StationsByOrder, PhotosBesideOneStationAreItsAndManyInARowAreOne) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(TwoStations());
  ScanFeatures features = SyntheticScanFeatures(turntable);
  std::set<size_t> lost = Range(12, 24);
  lost.insert({0, 3, 7, 8});
  Lose(lost, &features);
  const auto stations = StationsByOrder(features);
  ASSERT_TRUE(stations);
  EXPECT_EQ(Partition(*stations), (std::set<std::set<size_t>>{Range(0, 12), Range(12, 24)}));
}

// A few at the border are of either, or of a place of their own.
TEST(StationsByOrder, AtTheBorderOfTwoStationsNothingIsTold) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(TwoStations());
  ScanFeatures features = SyntheticScanFeatures(turntable);
  EXPECT_FALSE(StationsByOrder(features));
  Lose({11, 12}, &features);
  EXPECT_FALSE(StationsByOrder(features));
}

// Photos that are stations by themselves are placed by points that others show, and here too few pairs of
// photos prove a motion for there to be any.
TEST(PlaceWithStationsJoined, APlaceThatNoPictureTellsIsProvenByItsTurn) {
  SyntheticTurntableOptions options = TwoStations();
  options.steps = 8;
  options.step_deg = 45;
  options.num_object_points = 100;
  options.pixel_noise = 0.3;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  ScanFeatures features = SyntheticScanFeatures(turntable);
  Lose(Range(8, 16), &features);
  features.raw_pairs = std::exchange(features.object_pairs, {});
  const ReadDescriptors no_descriptors = [](int) { return std::vector<uint8_t>(); };
  Reporter reporter;
  ScanPlacement alone = PlaceScan(features, {}, nullptr, no_descriptors, {}, {}, reporter);
  EXPECT_EQ(alone.best.aligned.scene.views.size(), 8);
  const auto joined = PlaceWithStationsJoined(features, &alone, {}, no_descriptors, {}, {}, reporter);
  ASSERT_TRUE(joined);
  EXPECT_EQ(joined->placement.best.aligned.scene.views.size(), 16);
  EXPECT_EQ(joined->finding,
            "7 photos belong to others' camera places by the order of the photos: 2 stations");
}

}  // namespace
}  // namespace s2gs
