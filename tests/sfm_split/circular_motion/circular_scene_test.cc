#include "sfm_split/circular_motion/circular_scene.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <vector>

#include "tests/support/synthetic_scan.h"

namespace s2gs {
namespace {

// Two stations whose steps differ, so that a photo has no place but by its own matches.
SyntheticTurntableOptions Uneven() {
  SyntheticTurntableOptions options;
  options.seed = 5;
  options.stations = 2;
  options.min_elevation_deg = 20;
  options.steps = 18;
  options.step_deg = 20;
  options.step_jitter = 0.6;
  options.num_object_points = 200;
  options.num_platter_points = 0;
  options.num_background_points = 60;
  options.max_view_change_deg = 50;
  options.pixel_noise = 0.5;
  options.outlier_share = 0.2;
  return options;
}

// A station's photos have one lens; those of a station with two say nothing of either.
TEST(CircularStations, OfTwoCamerasHaveNoMatches) {
  ScanFeatures features = SyntheticScanFeatures(MakeSyntheticTurntable(Uneven()));
  const uint32_t own = features.cameras.begin()->first;
  std::vector<int> numbers;
  std::vector<CircularStation> stations = CollectCircularStations(features, {own}, &numbers);
  ASSERT_EQ(stations.size(), 2U);
  EXPECT_EQ(numbers, (std::vector<int>{0, 1}));
  for (const CircularStation& station : stations) {
    EXPECT_EQ(station.num_photos, 18);
    EXPECT_FALSE(station.pairs.empty());
  }
  features.cameras[own + 1] = features.cameras[own];
  features.images[20].camera_id = own + 1;
  ASSERT_EQ(features.images[20].station, 1);
  const std::vector<CircularStation> mixed = CollectCircularStations(features, {own, own + 1}, &numbers);
  ASSERT_EQ(mixed.size(), 2U);
  EXPECT_EQ(mixed[0].pairs.size(), stations[0].pairs.size());
  EXPECT_TRUE(mixed[1].pairs.empty());
  EXPECT_EQ(mixed[1].num_photos, 18);
}

// A photo that its own station does not place says nothing of how stations stand to each other, whatever it
// shares with the other one.
TEST(CircularScene, PhotosWithoutAPlaceTieNothing) {
  ScanFeatures features = SyntheticScanFeatures(MakeSyntheticTurntable(Uneven()));
  const auto is_lost = [](int image) { return image >= 20 && image % 3 != 0; };
  const auto drop = [&](bool within, bool between) {
    std::vector<ImagePairMatches>& pairs = features.object_pairs;
    pairs.erase(std::remove_if(pairs.begin(), pairs.end(),
                               [&](const ImagePairMatches& pair) {
                                 if (!is_lost(pair.image1) && !is_lost(pair.image2)) return false;
                                 const bool is_within =
                                     features.images[static_cast<size_t>(pair.image1)].station ==
                                     features.images[static_cast<size_t>(pair.image2)].station;
                                 return is_within ? within : between;
                               }),
                pairs.end());
  };
  Reporter reporter;
  drop(true, false);
  CircularFinding finding;
  const AlignedScene with = SceneFromCircularMotion(features, {}, reporter, &finding);
  drop(false, true);
  CircularFinding other;
  const AlignedScene without = SceneFromCircularMotion(features, {}, reporter, &other);
  ASSERT_EQ(finding.placed_stations, 2);
  ASSERT_EQ(other.placed_stations, 2);
  const std::vector<View>& views = with.scene.views;
  ASSERT_EQ(views.size(), without.scene.views.size());
  ASSERT_LT(views.size(), 30U);
  for (size_t i = 0; i < views.size(); ++i) {
    EXPECT_EQ(views[i].name, without.scene.views[i].name);
    EXPECT_EQ(views[i].cam_from_world.translation, without.scene.views[i].cam_from_world.translation);
    EXPECT_EQ(views[i].angle_deg, without.scene.views[i].angle_deg);
  }
}

}  // namespace
}  // namespace s2gs
