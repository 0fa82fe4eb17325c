#include "sfm_split/base/median_of_pictures.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <vector>

namespace s2gs {
namespace {

using Bytes = std::vector<uint8_t>;

TEST(MedianOfPictures, IsTheLargerOfTwoInTheMiddleAtEachPlace) {
  const Bytes a = {1, 40, 7, 9}, b = {2, 30, 7, 200}, c = {3, 20, 7, 100}, d = {4, 10, 7, 0};
  EXPECT_EQ(MedianOfPictures({&a, &b, &c, &d}, 2), (Bytes{3, 30, 7, 100}));
  EXPECT_EQ(MedianOfPictures({&a, &b, &c}, 2), (Bytes{2, 30, 7, 100}));
}

// A picture of half the exposure is brought to the others' light; what comes to more than 255 stays there.
TEST(MedianOfPictures, GainsComeBeforeIt) {
  const Bytes bright = {100, 201, 250, 6}, dark = {50, 100, 130, 3}, other = {0, 255, 255, 250};
  EXPECT_EQ(MedianOfPictures({&bright, &dark, &other}, 4, {1, 2, 1}), (Bytes{100, 201, 255, 6}));
  EXPECT_EQ(MedianOfPictures({&bright, &dark, &other}, 4, {0.5, 1, 0.5}), (Bytes{50, 101, 128, 3}));
  EXPECT_EQ(MedianOfPictures({&bright, &dark, &other}, 4, {1, 1, 1}),
            MedianOfPictures({&bright, &dark, &other}, 4));
}

}  // namespace
}  // namespace s2gs
