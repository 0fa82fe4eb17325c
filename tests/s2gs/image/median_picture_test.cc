#include "s2gs/image/median_picture.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <vector>

namespace s2gs {
namespace {

TEST(MedianPicture, LeavesOutWhatIsInFewPhotos) {
  std::vector<Image8> photos;
  for (int i = 0; i < 5; ++i) {
    Image8 photo{2, 1, 3, {10, 20, 30, 40, 50, 60}};
    photo.pixels[i] = 200;
    photos.push_back(photo);
  }
  EXPECT_EQ(MedianPicture(photos).pixels, (std::vector<uint8_t>{10, 20, 30, 40, 50, 60}));
}

}  // namespace
}  // namespace s2gs
