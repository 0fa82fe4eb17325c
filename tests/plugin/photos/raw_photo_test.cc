#include <gtest/gtest.h>

#include <array>
#include <cstddef>

#include "plugin/photos/foreign_photo.h"
#include "s2gs/image/srgb.h"
#include "tests/support/dng_file.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

constexpr int kWidth = 128;
constexpr int kHeight = 96;

// Four colours, one a quarter.
std::array<double, 3> Quarters(int x, int y) {
  if (y < kHeight / 2) return x < kWidth / 2 ? std::array{.5, .5, .5} : std::array{.6, .2, .1};
  return x < kWidth / 2 ? std::array{.1, .4, .2} : std::array{.05, .1, .5};
}

DngPhoto Photo() { return {kWidth, kHeight, Quarters, 1, 43.3, {}}; }

ForeignPhoto Read(const DngPhoto& photo) {
  const TemporaryFolder folder;
  WriteDng(folder / "a.dng", photo);
  return ReadForeignPhoto(folder / "a.dng");
}

TEST(RawPhoto, ColoursAreThoseOfTheLight) {
  const ForeignPhoto photo = Read(Photo());
  ASSERT_EQ(photo.image.width, kWidth);
  ASSERT_EQ(photo.image.height, kHeight);
  for (const auto& [x, y] :
       {std::array{32, 24}, std::array{96, 24}, std::array{32, 72}, std::array{96, 72}}) {
    for (int c = 0; c < 3; ++c) {
      // Rounded to grey values: .484 off at most.
      EXPECT_NEAR(photo.image.pixels[3 * (static_cast<size_t>(y) * kWidth + x) + c],
                  255 * SrgbFromLight(Quarters(x, y)[c]), 0.51)
          << x << ' ' << y << ' ' << c;
    }
  }
  EXPECT_NEAR(photo.tags.focal_mm, 43.3, 1e-3);
  EXPECT_EQ(photo.tags.orientation, 1);
}

// The focal length belongs to all pixels that the lens drew.
TEST(RawPhoto, CropsAreNotFollowed) {
  DngPhoto cropped = Photo();
  cropped.crop = {16, 12, 96, 72};
  EXPECT_EQ(Read(cropped).image.pixels, Read(Photo()).image.pixels);
}

// The developer does it, and nothing is left to be turned.
TEST(RawPhoto, StandUpright) {
  DngPhoto on_its_side = Photo();
  on_its_side.orientation = 6;  // to be turned clockwise by a quarter
  const Image8 stored = Read(Photo()).image;
  const ForeignPhoto photo = Read(on_its_side);
  EXPECT_EQ(photo.tags.orientation, 1);
  ASSERT_EQ(photo.image.width, kHeight);
  ASSERT_EQ(photo.image.height, kWidth);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const size_t upright = static_cast<size_t>(x) * kHeight + (kHeight - 1 - y);
      ASSERT_EQ(photo.image.pixels[3 * upright], stored.pixels[3 * (static_cast<size_t>(y) * kWidth + x)]);
    }
  }
}

}  // namespace
}  // namespace s2gs
