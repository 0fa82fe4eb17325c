#include "mesh/texture/page_fill.h"

#include <gtest/gtest.h>

#include <vector>

namespace s2gs {
namespace {

// Two texels with a colour among blank ones.
TEST(FillGutters, LeavesSeenTexelsAsTheyAre) {
  Image8 page{5, 1, 3, {0, 0, 0, 10, 20, 30, 0, 0, 0, 0, 0, 0, 50, 80, 110}};
  std::vector<uint8_t> states = {kBlankTexel, kSeenTexel, kBlankTexel, kBlankTexel, kSeenTexel};
  FillGutters(0, &states, &page);
  // The mean of both.
  EXPECT_EQ(page.pixels, (std::vector<uint8_t>{30, 50, 70, 10, 20, 30, 30, 50, 70, 30, 50, 70, 50, 80, 110}));
}

TEST(FillGutters, ContinuesColoursByTheGutter) {
  Image8 page{6, 1, 3, std::vector<uint8_t>(18, 0)};
  for (int c = 0; c < 3; ++c) page.pixels[static_cast<size_t>(c)] = 90;
  std::vector<uint8_t> states(6, kBlankTexel);
  states[0] = kSeenTexel;
  page.pixels[15] = page.pixels[16] = page.pixels[17] = 10;
  states[5] = kSeenTexel;
  FillGutters(1, &states, &page);
  // Each neighbour its own side's colour, what lies between them the mean of the texels with a colour.
  EXPECT_EQ(page.pixels[3], 90);
  EXPECT_EQ(page.pixels[12], 10);
  EXPECT_EQ(page.pixels[6], 50);
}

TEST(FillGutters, LeavesAPageWithoutColoursAlone) {
  Image8 page{2, 1, 3, {1, 2, 3, 4, 5, 6}};
  std::vector<uint8_t> states = {kUnseenTexel, kBlankTexel};
  FillGutters(2, &states, &page);
  EXPECT_EQ(page.pixels, (std::vector<uint8_t>{1, 2, 3, 4, 5, 6}));
}

}  // namespace
}  // namespace s2gs
