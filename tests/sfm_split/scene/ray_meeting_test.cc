#include "sfm_split/scene/ray_meeting.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>

namespace s2gs {
namespace {

using Eigen::Vector3d;

TEST(MeetingOfRays, IsWhereTheyMeet) {
  const Vector3d x(0.3, -0.2, 4);
  const Vector3d centre1(1, 0, 0);
  const Vector3d centre2(-1, 0.5, 0.2);
  const auto met = MeetingOfRays<double>(centre1, 3 * (x - centre1), centre2, 0.1 * (x - centre2));
  ASSERT_TRUE(met);
  EXPECT_LT((*met - x).norm(), 1e-12);
}

// Two that cross at right angles, .2 apart.
TEST(MeetingOfRays, IsHalfWayBetweenRaysThatPassEachOther) {
  const auto met = MeetingOfRays<double>({-1, 0, 0.1}, {1, 0, 0}, {0, -1, -0.1}, {0, 1, 0});
  ASSERT_TRUE(met);
  EXPECT_LT(met->norm(), 1e-12);
}

TEST(MeetingOfRays, IsNoneBehindOrOfParallelRays) {
  EXPECT_FALSE(MeetingOfRays<double>({-1, 0, 0}, {-1, 0, 0}, {0, -1, 0}, {0, 1, 0}));
  EXPECT_FALSE(MeetingOfRays<double>({-1, 0, 0}, {1, 0, 0}, {0, -1, 0}, {0, -1, 0}));
  EXPECT_FALSE(MeetingOfRays<double>({-1, 0, 0}, {1, 0, 0}, {0, -1, 0}, {2, 0, 0}));
}

}  // namespace
}  // namespace s2gs
