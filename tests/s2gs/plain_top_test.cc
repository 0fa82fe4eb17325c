#include "s2gs/plain_top.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>
#include <vector>

#include "s2gs/opaque_region.h"
#include "tests/s2gs/table_on_ground.h"

namespace s2gs {
namespace {

constexpr int kPhotos = 12;

RotatingRegion Table() { return {TurntableAxis(), kTableRadius, kTableBottom, kTableTop}; }

RotatingRegion Level(double height) { return {TurntableAxis(), kTableRadius, height, height}; }

// What a model shows that has a level layer instead of the table's top.
RenderedView LayerAt(double height, const PinholeView& view) {
  RenderedView rendered;
  rendered.width = view.width;
  rendered.height = view.height;
  const size_t count = static_cast<size_t>(view.width) * view.height;
  rendered.alpha.assign(count, 0);
  rendered.median_depth.assign(count, 0);
  rendered.expected_depth.assign(count, 0);
  rendered.normal.assign(3 * count, 0);
  DrawOpaqueRegion(Level(height), view, &rendered);
  return rendered;
}

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
    top = PlainTop::Learn(stations, Table());
  }
  const Image8& Photo(int i) const { return scene.photos[i].image; }
  const PinholeView& View(int i) const { return scene.photos[i].view; }

  TrainingScene scene;
  std::vector<StationPhotos> stations;
  std::optional<PlainTop> top;
};

// A card of another colour, with texture or without.
INSTANTIATE_TEST_SUITE_P(Card, PlainTopTest, testing::Values(TableTop::kPlain, TableTop::kGreyCard));

TEST_P(PlainTopTest, IsBareWhereMostPhotosSeeIt) {
  ASSERT_TRUE(top);
  for (double angle = 0; angle < 6; angle += 0.5) {
    for (const double radius : {0.5, 0.7, 0.9})
      EXPECT_TRUE(top->IsBare({radius * std::cos(angle), radius * std::sin(angle), 0.3}))
          << angle << " " << radius;
    EXPECT_FALSE(top->IsBare({0.15 * std::cos(angle), 0.15 * std::sin(angle), 0.3})) << angle;
    EXPECT_FALSE(top->IsBare({1.5 * std::cos(angle), 1.5 * std::sin(angle), 0.3})) << angle;
  }
  // The card with half patches about it is .65 x .8 of the top's 3.14.
  EXPECT_NEAR(top->BareShare(), 0.83, 0.05);
}

TEST_P(PlainTopTest, TakesThePlaceOfALayerOverIt) {
  ASSERT_TRUE(top);
  const PinholeView& view = View(1);
  const std::vector<TopSight> sights = top->Look(Photo(1), view, 0);
  const RenderedView layer = LayerAt(kTableTop + 0.1, view);
  RenderedView drawn = layer;
  DrawPlainTop(*top, sights, view, &drawn);
  const RenderedView level = LayerAt(kTableTop, view);
  const Rigid3 object_from_cam = view.cam_from_object.Inverse();
  int on_card = 0;
  int replaced = 0;
  for (int y = 0; y < view.height; ++y) {
    for (int x = 0; x < view.width; ++x) {
      const size_t i = static_cast<size_t>(y) * view.width + x;
      if (!(layer.alpha[i] > 0)) continue;
      const Eigen::Vector3d ray((x + 0.5 - view.cx) / view.fx, (y + 0.5 - view.cy) / view.fy, 1);
      const Eigen::Vector3d at = object_from_cam * (layer.median_depth[i] * ray);
      if (at.head<2>().cwiseAbs().maxCoeff() < kCardHalfSide) {
        ++on_card;
        EXPECT_EQ(drawn.median_depth[i], layer.median_depth[i]);
      }
      if (drawn.median_depth[i] == layer.median_depth[i]) continue;
      ++replaced;
      EXPECT_EQ(drawn.median_depth[i], level.median_depth[i]);
      EXPECT_EQ(drawn.expected_depth[i], level.median_depth[i]);
      EXPECT_EQ(drawn.normal[3 * i + 2], level.normal[3 * i + 2]);
    }
  }
  EXPECT_GT(on_card, 100);
  EXPECT_GT(replaced, 0.6 * static_cast<double>(std::count(level.alpha.begin(), level.alpha.end(), 1.0F)));

  // So high nothing is a plain top's wrong shape.
  const RenderedView high = LayerAt(kTableTop + 0.3, view);
  RenderedView drawn_high = high;
  DrawPlainTop(*top, sights, view, &drawn_high);
  for (size_t i = 0; i < high.alpha.size(); ++i) {
    if (high.alpha[i] > 0) {
      ASSERT_EQ(drawn_high.median_depth[i], high.median_depth[i]);
    }
  }
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

TEST_P(PlainTopTest, OtherStationsAndShortOnesShowNothing) {
  ASSERT_TRUE(top);
  EXPECT_EQ(Count(top->Look(Photo(0), View(0), 1), TopSight::kOther), kTablePhotoWidth * kTablePhotoHeight);
  EXPECT_FALSE(PlainTop::Learn({}, Table()));
}

TEST(PlainTop, ATopWithTextureHasNoColor) {
  EXPECT_FALSE(PlainTop::Learn(LoadStations(TableOnGround(kPhotos, TableTop::kTiled)), Table()));
}

}  // namespace
}  // namespace s2gs
