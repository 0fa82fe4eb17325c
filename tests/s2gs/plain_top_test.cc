#include "s2gs/plain_top.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>
#include <vector>

#include "tests/s2gs/table_on_ground.h"

namespace s2gs {
namespace {

constexpr int kPhotos = 12;

int Count(const std::vector<TopSight>& sights, TopSight which) {
  return static_cast<int>(std::count(sights.begin(), sights.end(), which));
}

// The photo times these factors by channel.
Image8 InLight(Image8 photo, double red, double others) {
  for (size_t i = 0; i < photo.pixels.size(); ++i) {
    photo.pixels[i] = static_cast<uint8_t>(std::lround(photo.pixels[i] * (i % 3 == 0 ? red : others)));
  }
  return photo;
}

class PlainTopTest : public testing::TestWithParam<TableTop> {
 protected:
  PlainTopTest() : scene(TableOnGround(kPhotos, GetParam())), stations(LoadStations(scene)) {
    top = PlainTop::Learn(stations, TableRegion());
  }
  const Image8& Photo(int i) const { return scene.photos[i].image; }
  const PinholeView& View(int i) const { return scene.photos[i].view; }
  std::vector<std::vector<float>> NothingHides() const {
    return std::vector<std::vector<float>>(kPhotos,
                                           std::vector<float>(kTablePhotoWidth * kTablePhotoHeight, 0));
  }

  TrainingScene scene;
  std::vector<StationPhotos> stations;
  std::optional<PlainTop> top;
};

// A card of another colour, with texture or without.
INSTANTIATE_TEST_SUITE_P(Card, PlainTopTest, testing::Values(TableTop::kPlain, TableTop::kGreyCard));

// Rotating Gaussians at one height over bare places and over the card, and such as stand still.
TEST_P(PlainTopTest, LayersOverItAreFoundAndWhatStandsOnTheCardStays) {
  ASSERT_TRUE(top);
  Placement gaussians;
  std::vector<uint32_t> expected;
  const auto add = [&](double radius, double angle, double height, float logit) {
    for (const double x : {radius * std::cos(angle), radius * std::sin(angle), height})
      gaussians.centre.push_back(static_cast<float>(x));
    gaussians.foreground_logit.push_back(logit);
  };
  for (double angle = 0; angle < 6; angle += 0.25) {
    for (const double height : {0.1, 0.2}) {
      expected.push_back(static_cast<uint32_t>(gaussians.size()));
      add(0.75, angle, kTableTop + height, 5);
      add(0.75, angle, kTableTop + height, -5);  // stands still
      add(1.3, angle, kTableTop + height, 5);    // beside the table
    }
    add(0.1, angle, kTableTop + 1.2 * kTablePixel, 5);  // on the card
    add(0.75, angle, kTableTop + 0.5 * kTablePixel, 5);
    add(0.75, angle, kTableBottom, 5);
  }
  EXPECT_EQ(FindLayersOverTop(*top, stations, NothingHides(), gaussians), expected);
  EXPECT_TRUE(FindLayersOverTop(*top, {}, {}, gaussians).empty());
}

// A thing of another colour over a bare place: photos show it, and not the top behind it.
TEST_P(PlainTopTest, WhatReachesOverItIsNoLayer) {
  ASSERT_TRUE(top);
  const Eigen::Vector3d x(0.6, 0, kTableTop + 0.3);
  for (StationPhotos& station : stations) {
    for (size_t i = 0; i < station.views.size(); ++i) {
      const PinholeView& view = station.views[i];
      const Eigen::Vector2d pixel = *PixelOf(view, view.cam_from_object * x);
      for (int v = -4; v <= 4; ++v) {
        for (int u = -4; u <= 4; ++u) {
          uint8_t* color =
              station.images[i].Pixel(static_cast<int>(pixel.x()) + u, static_cast<int>(pixel.y()) + v);
          std::fill_n(color, 3, 190);
        }
      }
    }
  }
  top = PlainTop::Learn(stations, TableRegion());
  ASSERT_TRUE(top);
  Placement gaussians;
  for (int k = 0; k < 3; ++k) gaussians.centre.push_back(static_cast<float>(x[k]));
  gaussians.foreground_logit.push_back(5);
  EXPECT_TRUE(FindLayersOverTop(*top, stations, NothingHides(), gaussians).empty());
  // Was the thing before it, none of them says that it is there; and none sees the top.
  std::vector<std::vector<float>> hidden = NothingHides();
  for (std::vector<float>& depths : hidden) std::fill(depths.begin(), depths.end(), 1.0F);
  EXPECT_TRUE(FindLayersOverTop(*top, stations, hidden, gaussians).empty());
  // Where photos see the top instead, it is not there; a single one may be chance.
  stations[0].images[3] = scene.photos[3].image;
  EXPECT_TRUE(FindLayersOverTop(*top, stations, hidden, gaussians).empty());
  for (int i = 0; i < kPhotos; ++i) stations[0].images[i] = scene.photos[i].image;
  EXPECT_EQ(FindLayersOverTop(*top, stations, hidden, gaussians).size(), 1U);
}

TEST_P(PlainTopTest, AShadowHasItsTintAndAPhotoItsExposure) {
  ASSERT_TRUE(top);
  const std::vector<TopSight> sights = top->Look(Photo(2), View(2), 0);
  const int lit = Count(sights, TopSight::kLit);
  EXPECT_GT(lit, 1000);
  EXPECT_NEAR(Count(top->Look(InLight(Photo(2), 0.8, 0.9), View(2), 0), TopSight::kLit), lit, 0.02 * lit);

  // The left half in a shadow, which leaves most of the ring's pixels on the right lit.
  const auto shaded = [&](double red, double others) {
    Image8 photo = Photo(2);
    const Image8 dark = InLight(Photo(2), red, others);
    for (int y = 0; y < photo.height; ++y)
      std::copy_n(dark.Pixel(0, y), 3 * (photo.width * 9 / 20), photo.Pixel(0, y));
    return Count(top->Look(photo, View(2), 0), TopSight::kShadow);
  };
  const int in_shadow = Count(sights, TopSight::kShadow);
  EXPECT_GT(shaded(0.6, 0.6), in_shadow + lit / 4);
  EXPECT_LT(shaded(0.4, 0.7), in_shadow + lit / 50);
}

TEST_P(PlainTopTest, OtherStationsAndNoneShowNothing) {
  ASSERT_TRUE(top);
  EXPECT_EQ(Count(top->Look(Photo(0), View(0), 1), TopSight::kElsewhere),
            kTablePhotoWidth * kTablePhotoHeight);
  EXPECT_FALSE(PlainTop::Learn({}, TableRegion()));
}

TEST(PlainTop, ATopWithTextureHasNoColor) {
  EXPECT_FALSE(PlainTop::Learn(LoadStations(TableOnGround(kPhotos, TableTop::kTiled)), TableRegion()));
}

}  // namespace
}  // namespace s2gs
