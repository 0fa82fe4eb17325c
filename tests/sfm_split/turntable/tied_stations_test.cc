#include "sfm_split/turntable/tied_stations.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <set>
#include <string>
#include <utility>
#include <vector>

namespace s2gs {
namespace {

// Two photos a station, and background points that these photos see.
AlignedScene Scene(int num_stations, const std::vector<std::vector<int>>& stations_of_point) {
  AlignedScene aligned;
  aligned.scene.num_stations = num_stations;
  for (int i = 0; i < 2 * num_stations; ++i) {
    const auto id = static_cast<uint32_t>(i + 1);
    View view;
    view.name = std::to_string(i);
    view.station = i / 2;
    aligned.scene.views.push_back(view);
    ColmapImage image;
    image.image_id = id;
    image.name = view.name;
    aligned.background.images[id] = image;
  }
  uint64_t point_id = 0;
  for (const std::vector<int>& stations : stations_of_point) {
    ColmapPoint3D point;
    for (const int s : stations) point.track.push_back({static_cast<uint32_t>(2 * s + 1), 0});
    aligned.background.points3D[++point_id] = point;
  }
  return aligned;
}

TEST(TiedStations, GoBySharedPointsAndOthersInBetween) {
  EXPECT_EQ(TiedStations(Scene(5, {{0, 3}, {3, 2}, {1, 4}})), (std::set<int>{0, 2, 3}));
}

TEST(TiedStations, AreNoneWhereTheReferenceIsAlone) {
  EXPECT_TRUE(TiedStations(Scene(3, {{1, 2}, {0, 0}})).empty());
  EXPECT_TRUE(TiedStations(Scene(1, {{0}})).empty());
}

TEST(TiedStations, SetsHoldEachStationOnce) {
  using Sets = std::vector<std::vector<int>>;
  EXPECT_EQ(SetsOfTiedStations(Scene(5, {{0, 3}, {3, 2}, {1, 4}})), (Sets{{0, 2, 3}, {1, 4}}));
  EXPECT_EQ(SetsOfTiedStations(Scene(3, {})), (Sets{{0}, {1}, {2}}));
  EXPECT_EQ(SetsOfTiedStations(Scene(2, {{1, 0}})), (Sets{{0, 1}}));
}

TEST(TiedStations, ImagesThatAreNoViewsTieNothing) {
  AlignedScene aligned = Scene(2, {{0, 1}});
  aligned.scene.views.resize(2);
  EXPECT_TRUE(TiedStations(aligned).empty());
}

}  // namespace
}  // namespace s2gs
