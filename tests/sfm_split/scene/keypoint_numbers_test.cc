#include "sfm_split/scene/keypoint_numbers.h"

#include <gtest/gtest.h>

namespace s2gs {
namespace {

TEST(KeypointNumbers, GoOnFromImageToImage) {
  KeypointNumbers numbers;
  EXPECT_EQ(numbers.Count(), 0U);
  for (const size_t count : {3U, 0U, 2U}) numbers.Add(count);
  EXPECT_EQ(numbers.Count(), 5U);
  EXPECT_EQ(numbers.Of(0, 0), 0U);
  EXPECT_EQ(numbers.Of(0, 2), 2U);
  EXPECT_EQ(numbers.Of(2, 0), 3U);
  EXPECT_EQ(numbers.Of(2, 1), 4U);
}

}  // namespace
}  // namespace s2gs
