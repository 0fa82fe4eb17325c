#include "sfm_split/scene/number_stations.h"

#include <gtest/gtest.h>

namespace s2gs {
namespace {

// A station that was taken out and placed anew has a number beyond the others', and its old one is gone.
TEST(NumberStations, LeavesNoGaps) {
  TurntableScene scene;
  scene.num_stations = 9;
  for (const int station : {3, 0, 5, 3, 0}) {
    View view;
    view.station = station;
    scene.views.push_back(view);
  }
  NumberStations(&scene);
  EXPECT_EQ(scene.num_stations, 3);
  const int expected[] = {1, 0, 2, 1, 0};
  for (size_t i = 0; i < 5; ++i) EXPECT_EQ(scene.views[i].station, expected[i]) << i;
  scene.views.clear();
  NumberStations(&scene);
  EXPECT_EQ(scene.num_stations, 0);
}

}  // namespace
}  // namespace s2gs
