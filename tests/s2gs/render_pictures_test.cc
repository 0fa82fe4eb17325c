#include "s2gs/render_pictures.h"

#include <gtest/gtest.h>

#include <array>
#include <cstdint>
#include <cstdlib>
#include <vector>

namespace s2gs {
namespace {

using Rgb = std::array<int, 3>;

Rgb At(const Image8& image, int x, int y) {
  const uint8_t* p = image.Pixel(x, y);
  return {p[0], p[1], p[2]};
}

// Halves of a grey value may be rounded either way.
void ExpectColor(const Image8& image, int x, const Rgb& expected) {
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(At(image, x, 0)[c], expected[c], 1) << x << " " << c;
}

TEST(RenderPictures, MasksAreBlackAndWhite) {
  const Image8 image = MaskImage({3, 1, {0, 1, 7}});
  EXPECT_EQ(image.width, 3);
  EXPECT_EQ(image.channels, 1);
  EXPECT_EQ(image.pixels, (std::vector<uint8_t>{0, 255, 255}));
}

// Ramps of red, green and blue that each are 1.5 - 4 |t - middle| for t from .1 to .9: by hand.
TEST(RenderPictures, DepthsGoFromRedOverGreenToBlue) {
  const Image8 image = DepthPicture({3, 2, 0, 4, 2.5F, -1, 6}, 7, 1);
  // 2 is the nearest, 6 the farthest: t = .1 + .8 (z - 2) / 4.
  ExpectColor(image, 1, Rgb{230, 0, 0});      // t = .1: 1.5 - .6 = .9 of red
  ExpectColor(image, 4, Rgb{255, 77, 0});     // t = .2: 1.3 and .3
  ExpectColor(image, 0, Rgb{255, 179, 0});    // t = .3: 1.3 and .7
  ExpectColor(image, 3, Rgb{128, 255, 128});  // t = .5
  ExpectColor(image, 6, Rgb{0, 0, 230});      // t = .9
  ExpectColor(image, 2, Rgb{0, 0, 0});        // nothing there
  ExpectColor(image, 5, Rgb{0, 0, 0});
  // One depth alone is the nearest; none is black.
  ExpectColor(DepthPicture({0, 5}, 2, 1), 1, Rgb{230, 0, 0});
  EXPECT_EQ(DepthPicture({0, 0}, 1, 2).pixels, std::vector<uint8_t>(6, 0));
  EXPECT_EQ(DepthPicture({0, 0}, 1, 2).height, 2);
}

TEST(RenderPictures, NormalsAreColoursAsSeenByTheViewer) {
  RenderedView view;
  view.width = 5;
  view.height = 1;
  // Towards the camera, to the right, up (y down), not of unit length, and transparent.
  view.normal = {0, 0, -1, 1, 0, 0, 0, -1, 0, 0, 0.3F, -0.4F, 0, 0, -1};
  view.alpha = {1, 0.5F, 0.9F, 1, 0.49F};
  const Image8 image = NormalPicture(view);
  EXPECT_EQ(At(image, 0, 0), (Rgb{128, 128, 255}));
  EXPECT_EQ(At(image, 1, 0), (Rgb{255, 128, 128}));
  EXPECT_EQ(At(image, 2, 0), (Rgb{128, 255, 128}));
  EXPECT_EQ(At(image, 3, 0), (Rgb{128, 51, 230}));  // (0, .6, -.8): .5 - .3 and .5 + .4
  EXPECT_EQ(At(image, 4, 0), (Rgb{0, 0, 0}));
  view.normal.assign(15, 0);
  EXPECT_EQ(NormalPicture(view).pixels, std::vector<uint8_t>(15, 0));
}

TEST(RenderPictures, OverviewsShowFourPhotosSpreadEvenly) {
  EXPECT_EQ(OverviewPhotos(0), std::vector<size_t>{});
  EXPECT_EQ(OverviewPhotos(3), (std::vector<size_t>{0, 1, 2}));
  EXPECT_EQ(OverviewPhotos(4), (std::vector<size_t>{0, 1, 2, 3}));
  EXPECT_EQ(OverviewPhotos(10), (std::vector<size_t>{0, 2, 5, 7}));
  EXPECT_EQ(OverviewPhotos(60), (std::vector<size_t>{0, 15, 30, 45}));
}

TEST(RenderPictures, ComparisonsHavePhotoRenderingErrorAndMask) {
  Image8 photo{3, 2, 3, {}};
  Image8 rendered{3, 2, 3, {}};
  for (int i = 0; i < 18; ++i) {
    photo.pixels.push_back(static_cast<uint8_t>(10 * i));
    rendered.pixels.push_back(static_cast<uint8_t>(i % 2 == 0 ? 10 * i + 7 : 200));
  }
  const Image8 mask{3, 2, 1, {255, 0, 128, 127, 255, 0}};
  const Image8 picture = ComparisonPicture(photo, rendered, mask);
  ASSERT_EQ(picture.width, 12);
  ASSERT_EQ(picture.height, 2);
  for (int y = 0; y < 2; ++y) {
    for (int x = 0; x < 3; ++x) {
      const Rgb real = At(photo, x, y);
      const Rgb made = At(rendered, x, y);
      EXPECT_EQ(At(picture, x, y), real);
      EXPECT_EQ(At(picture, 3 + x, y), made);
      const bool inside = (x == 0 && y == 0) || (x == 2 && y == 0) || (x == 1 && y == 1);
      for (int c = 0; c < 3; ++c) {
        EXPECT_EQ(At(picture, 6 + x, y)[c], std::min(255, 4 * std::abs(real[c] - made[c])));
        EXPECT_EQ(At(picture, 9 + x, y)[c], inside ? real[c] : real[c] / 4);
      }
    }
  }
  // A photo of twice the size is halved.
  Image8 twice{6, 4, 3, std::vector<uint8_t>(72)};
  for (int y = 0; y < 4; ++y) {
    for (int x = 0; x < 6; ++x) {
      for (int c = 0; c < 3; ++c) twice.Pixel(x, y)[c] = photo.Pixel(x / 2, y / 2)[c];
    }
  }
  EXPECT_EQ(ComparisonPicture(twice, rendered, mask).pixels, picture.pixels);
}

}  // namespace
}  // namespace s2gs
