#include <gtest/gtest.h>

#include "s2gs/backend/backend.h"

namespace s2gs {
namespace {

TEST(SelectionOf, HasARegionOnlyWhereOneIsAskedFor) {
  RenderRequest request;
  const auto radius = [&] { return SelectionOf(request).side.outer.radius; };
  const float without = radius();
  RotatingSide side;
  side.region.radius = 3;
  side.inner_radius = 2;
  request.side = side;
  EXPECT_EQ(radius(), 3);
  EXPECT_EQ(SelectionOf(request).side.inner_radius, 2);
  request.side.reset();
  EXPECT_EQ(radius(), without);
  EXPECT_LE(without, 0);
}

}  // namespace
}  // namespace s2gs
