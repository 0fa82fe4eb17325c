#include "s2gs/image/srgb.h"

#include <gtest/gtest.h>

namespace s2gs {
namespace {

// IEC 61966-2-1, worked out with 20 digits.
TEST(Srgb, IsTheStandards) {
  EXPECT_NEAR(SrgbFromLight(0.5), 0.73535698305244945, 1e-12);
  EXPECT_NEAR(SrgbFromLight(0.001), 0.01292, 1e-12);
  EXPECT_NEAR(SrgbFromLight(1.0), 1, 1e-12);
  EXPECT_NEAR(LightFromSrgb(0.5), 0.21404114048223255, 1e-12);
  EXPECT_NEAR(LightFromSrgb(0.02), 0.02 / 12.92, 1e-12);
}

TEST(Srgb, GoesThereAndBackAndHasItsSlope) {
  for (double light = 0.0005; light < 1; light *= 1.3) {
    EXPECT_NEAR(LightFromSrgb(SrgbFromLight(light)), light, 1e-6 * light);
    // Central differences; the curve's two parts meet at .0031308.
    if (light > 0.0030 && light < 0.0033) continue;
    const double step = 1e-5 * light;
    const double slope = (SrgbFromLight(light + step) - SrgbFromLight(light - step)) / (2 * step);
    EXPECT_NEAR(SrgbSlope(light), slope, 1e-5 * slope);
  }
}

}  // namespace
}  // namespace s2gs
