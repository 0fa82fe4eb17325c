#include <gtest/gtest.h>

#include <cmath>
#include <utility>

#include "s2gs/kernel/intersect.h"
#include "tests/s2gs/kernel/kernel_scene.h"

namespace s2gs {
namespace {

// A disc of 2 pixels' radius that faces the camera, about a place of the picture of 80 x 60 pixels [px].
bool HasPixels(double x, double y, PixelRect* rect) {
  SplatCamera<double> camera = {};
  camera.width = 80;
  camera.height = 60;
  camera.fx = camera.fy = 100;
  camera.cx = 40;
  camera.cy = 30;
  camera.near_depth = 0.1;
  Surfel<double> surfel = {};
  surfel.centre = {(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1};
  surfel.axis_u = {1, 0, 0};
  surfel.axis_v = {0, 1, 0};
  surfel.log_scale = {std::log(0.02), std::log(0.02)};
  surfel.opacity = 0.9;
  Footprint<double> footprint;
  EXPECT_TRUE(ComputeFootprint(surfel, camera, &footprint));
  return BoundSplat(surfel, footprint, camera, rect);
}

// To a side of the picture there are none, whichever it is, though along the other axis there are some.
TEST(BoundSplat, HasNoPixelsBesideThePicture) {
  PixelRect rect{};
  EXPECT_TRUE(HasPixels(40, 30, &rect));
  EXPECT_LT(rect.x_begin, 40);
  EXPECT_GT(rect.x_end, 40);
  for (const auto& [x, y] : {std::pair(-30, 30), std::pair(110, 30), std::pair(40, -30), std::pair(40, 90)})
    EXPECT_FALSE(HasPixels(x, y, &rect)) << x << ' ' << y;
}

}  // namespace
}  // namespace s2gs
