#include "s2gs/table/plain_top.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <optional>
#include <vector>

#include "s2gs/core/rng.h"
#include "s2gs/image/median_picture.h"
#include "sfm_split/base/angles.h"
#include "tests/s2gs/table/table_on_ground.h"

namespace s2gs {
namespace {

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

// Under a light's shadow that stands still.
bool IsOnLeft(const Eigen::Vector2d& x_in_world) { return x_in_world.x() < -0.05; }

class PlainTopTest : public PlainTableTest {
 protected:
  const Image8& Photo(int i) const { return scene.photos[i].image; }
  const PinholeView& View(int i) const { return scene.photos[i].view; }
};

// A card of another colour, with texture or without.
INSTANTIATE_TEST_SUITE_P(Card, PlainTopTest, testing::Values(TopLook::kPlain, TopLook::kGreyCard));

TEST_P(PlainTopTest, AShadowHasItsTintAndAPhotoItsExposure) {
  ASSERT_TRUE(top);
  const std::vector<TopSight> sights = top->Look(Photo(2), View(2), 0);
  const int lit = Count(sights, TopSight::kLit);
  EXPECT_GT(lit, 1000);
  EXPECT_NEAR(Count(top->Look(InLight(Photo(2), 0.8, 0.9), View(2), 0), TopSight::kLit), lit, 0.02 * lit);

  // No photo of the station has a shadow: nothing is known of a darker place.
  const Image8 dark = ShadeTop(Photo(2), View(2), IsOnLeft, {0.6, 0.6, 0.6});
  const std::vector<TopSight> in_dark = top->Look(dark, View(2), 0);
  EXPECT_EQ(Count(in_dark, TopSight::kShadow), 0);
  EXPECT_LT(Count(in_dark, TopSight::kOther), Count(sights, TopSight::kOther) + lit / 50);
}

TEST_P(PlainTopTest, AShadowIsLearntWhereItFallsNextToTheRim) {
  ASSERT_TRUE(top);
  // The light's shadow is blue, and lies on the left in all photos.
  const auto learn_and_look = [&](const std::array<double, 3>& factors) {
    for (int i = 0; i < kTablePhotos; ++i)
      stations[0].images[i] = ShadeTop(Photo(i), View(i), IsOnLeft, {0.5, 0.55, 0.6});
    stations[0].still = MedianPicture(stations[0].images);
    const std::optional<PlainTop> shaded = PlainTop::Learn(stations, TableRegion());
    EXPECT_TRUE(shaded);
    return shaded->Look(ShadeTop(Photo(2), View(2), IsOnLeft, factors), View(2), 0);
  };
  const int lit = Count(top->Look(Photo(2), View(2), 0), TopSight::kLit);
  const int other = Count(top->Look(Photo(2), View(2), 0), TopSight::kOther);
  const std::vector<TopSight> umbra = learn_and_look({0.5, 0.55, 0.6});
  EXPECT_GT(Count(umbra, TopSight::kShadow), lit / 4);
  EXPECT_GT(Count(umbra, TopSight::kLit), lit / 4);
  EXPECT_LT(Count(umbra, TopSight::kOther), other + lit / 15);
  // Half of the sky is hidden, too.
  const std::vector<TopSight> without_sky = learn_and_look({0.35, 0.385, 0.42});
  EXPECT_GT(Count(without_sky, TopSight::kShadow), lit / 4);
  // In the light, a part of the sky hidden: that may be the top, and may be a thing.
  const std::vector<TopSight> in_light = learn_and_look({0.9, 0.9125, 0.925});
  EXPECT_LT(Count(in_light, TopSight::kShadow), lit / 50);
  EXPECT_LT(Count(in_light, TopSight::kOther), other + lit / 15);
  // Neither the one nor the other, or grey.
  for (const std::array<double, 3>& factors :
       {std::array<double, 3>{0.68, 0.7, 0.72}, std::array<double, 3>{0.5, 0.5, 0.5}}) {
    const std::vector<TopSight> of_a_thing = learn_and_look(factors);
    EXPECT_LT(Count(of_a_thing, TopSight::kShadow), lit / 50);
    EXPECT_GT(Count(of_a_thing, TopSight::kOther), other + lit / 4);
  }
}

// Shadows of several things, of any depth, lie on half of the ring next to the rim.
TEST_P(PlainTopTest, ShadowsMayLieOnHalfOfIt) {
  constexpr int kShadows = 3;
  const auto shaded = [&](int i) {
    Image8 photo = Photo(i);
    for (int k = 0; k < kShadows; ++k) {
      const double from = 2 * kPi * k / kShadows;
      const auto is_shaded = [&](const Eigen::Vector2d& x) {
        const double angle = std::atan2(x.y(), x.x()) + kPi;
        return x.norm() > 0.4 && angle > from && angle < from + kPi / kShadows;
      };
      const double factor = 0.5 + 0.13 * k;
      photo = ShadeTop(photo, View(i), is_shaded, {factor, factor, factor});
    }
    return photo;
  };
  ASSERT_TRUE(top);
  const int lit = Count(top->Look(Photo(2), View(2), 0), TopSight::kLit);
  for (int i = 0; i < kTablePhotos; ++i) stations[0].images[i] = shaded(i);
  stations[0].still = MedianPicture(stations[0].images);
  const std::optional<PlainTop> in_shadows = PlainTop::Learn(stations, TableRegion());
  ASSERT_TRUE(in_shadows);
  const int still_lit = Count(in_shadows->Look(shaded(2), View(2), 0), TopSight::kLit);
  // Measured .35: next to a border a photo does not tell.
  EXPECT_GT(still_lit, lit * 3 / 10);
  EXPECT_LT(still_lit, lit * 6 / 10);
}

// A border between two colours is neither.
TEST_P(PlainTopTest, NextToABorderAPhotoDoesNotTell) {
  ASSERT_TRUE(top);
  const std::vector<TopSight> bare = top->Look(Photo(2), View(2), 0);
  const auto is_strip = [](const Eigen::Vector2d& x) { return std::abs(x.x() + 0.6) < 0.02; };
  const std::vector<TopSight> sights =
      top->Look(ShadeTop(Photo(2), View(2), is_strip, {0.3, 0.9, 0.9}), View(2), 0);
  const int strip = Count(bare, TopSight::kLit) - Count(sights, TopSight::kLit);
  ASSERT_GT(strip, 100);
  EXPECT_GT(Count(sights, TopSight::kBorder) - Count(bare, TopSight::kBorder), strip * 9 / 10);
}

TEST_P(PlainTopTest, OtherStationsAndNoneShowNothing) {
  ASSERT_TRUE(top);
  EXPECT_EQ(Count(top->Look(Photo(0), View(0), 1), TopSight::kElsewhere),
            kTablePhotoWidth * kTablePhotoHeight);
  EXPECT_FALSE(PlainTop::Learn({}, TableRegion()));
}

// Grain of a top, as sharpening leaves it, is more than the photos' noise and still no texture.
TEST_P(PlainTopTest, ItsGrainIsNoTexture) {
  ASSERT_TRUE(top);
  const int lit = Count(top->Look(Photo(2), View(2), 0), TopSight::kLit);
  const auto grainy = [&](int i) {
    uint64_t seed = 1000 * static_cast<uint64_t>(i + 1);
    const auto is_dark = [&](const Eigen::Vector2d&) {
      return (RandomBits(29, ++seed, 0).words[0] & 1) != 0;
    };
    return ShadeTop(Photo(i), View(i), is_dark, {0.92, 0.92, 0.92});
  };
  for (int i = 0; i < kTablePhotos; ++i) stations[0].images[i] = grainy(i);
  stations[0].still = MedianPicture(stations[0].images);
  const std::optional<PlainTop> of_grain = PlainTop::Learn(stations, TableRegion());
  ASSERT_TRUE(of_grain);
  EXPECT_GT(Count(of_grain->Look(grainy(2), View(2), 0), TopSight::kLit), lit * 8 / 10);
}

// A speckled top has one colour between its spots: what hides the spots is a thing, whatever its colour.
TEST_P(PlainTopTest, SpotsWithGapsBetweenThemAreAPattern) {
  ASSERT_TRUE(top);
  constexpr double kApart = 0.2;
  const auto speckled = [&](int i, double spot_radius) {
    const Rigid3 object_from_world = View(i).cam_from_object.Inverse() * View(i).cam_from_world;
    const auto is_spot = [&](const Eigen::Vector2d& x_in_world) {
      const Eigen::Vector3d x =
          object_from_world * Eigen::Vector3d(x_in_world.x(), x_in_world.y(), kTableTop);
      const auto off = [&](double along) { return along - kApart * std::round(along / kApart); };
      return std::hypot(off(x.x()), off(x.y())) < spot_radius;
    };
    return ShadeTop(Photo(i), View(i), is_spot, {0.45, 0.45, 0.45});
  };
  const auto learn = [&](double spot_radius) {
    for (int i = 0; i < kTablePhotos; ++i) stations[0].images[i] = speckled(i, spot_radius);
    stations[0].still = MedianPicture(stations[0].images);
    return PlainTop::Learn(stations, TableRegion());
  };
  EXPECT_FALSE(learn(kApart / 9));
  EXPECT_TRUE(learn(0));
}

TEST(PlainTop, ATopWithTextureHasNoColor) {
  EXPECT_FALSE(PlainTop::Learn(LoadStations(TableOnGround(kTablePhotos, TopLook::kTiled)), TableRegion()));
}

}  // namespace
}  // namespace s2gs
