#include "s2gs/table/layers_over_top.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <optional>
#include <vector>

#include "s2gs/core/rng.h"
#include "s2gs/image/median_picture.h"
#include "s2gs/table/opaque_region.h"
#include "tests/s2gs/table/table_on_ground.h"

namespace s2gs {
namespace {

std::vector<std::vector<float>> NothingIsThere(const std::vector<uint32_t>& /*left_out*/) {
  return NothingHides();
}

class LayersOverTopTest : public PlainTableTest {};

// A card of another colour, with texture or without.
INSTANTIATE_TEST_SUITE_P(Card, LayersOverTopTest, testing::Values(TopLook::kPlain, TopLook::kGreyCard));

// Rotating Gaussians at one height over bare places and over the card, and such as stand still.
TEST_P(LayersOverTopTest, AreFoundAndWhatStandsOnTheCardStays) {
  ASSERT_TRUE(top);
  Placement gaussians;
  std::vector<uint32_t> expected;
  const auto add = [&](double radius, double angle, double height, float logit) {
    AddGaussian({radius * std::cos(angle), radius * std::sin(angle), height}, logit, &gaussians);
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
  EXPECT_EQ(FindLayersOverTop(*top, stations, NothingIsThere, gaussians, {}).gaussians, expected);
  EXPECT_TRUE(FindLayersOverTop(*top, {}, [](const auto&) { return std::vector<std::vector<float>>(); },
                                gaussians, {})
                  .gaussians.empty());
}

// A thing of another colour over a bare place: photos show it, and not the top behind it.
TEST_P(LayersOverTopTest, AreNotWhatReachesOverIt) {
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
  AddGaussian(x, 5, &gaussians);
  EXPECT_TRUE(FindLayersOverTop(*top, stations, NothingIsThere, gaussians, {}).gaussians.empty());
  // Was the thing before it, none of them says that it is there; and none sees the top.
  const DepthsWithout hidden = [](const std::vector<uint32_t>&) { return AllAt(1); };
  EXPECT_TRUE(FindLayersOverTop(*top, stations, hidden, gaussians, {}).gaussians.empty());
  // Where photos see the top instead, it is not there; a single one may be chance.
  stations[0].images[3] = scene.photos[3].image;
  EXPECT_TRUE(FindLayersOverTop(*top, stations, hidden, gaussians, {}).gaussians.empty());
  for (int i = 0; i < kTablePhotos; ++i) stations[0].images[i] = scene.photos[i].image;
  EXPECT_EQ(FindLayersOverTop(*top, stations, hidden, gaussians, {}).gaussians.size(), 1U);
}

// What is too high for a layer and goes for the top's light is a thing of its paint; a few may float.
TEST_P(LayersOverTopTest, StayWhereAThingGoesForTheTopsLight) {
  ASSERT_TRUE(top);
  Placement gaussians;
  for (double angle = 0; angle < 6; angle += 0.25)
    AddGaussian({0.75 * std::cos(angle), 0.75 * std::sin(angle), kTableTop + 0.1}, 5, &gaussians);
  const size_t num_layers = gaussians.size();
  for (int i = 0; i < 3; ++i) AddGaussian({0.5, 0, kTableTop + 0.41 + 0.001 * i}, 5, &gaussians);
  EXPECT_EQ(FindLayersOverTop(*top, stations, NothingIsThere, gaussians, {}).gaussians.size(),
            num_layers + 3);
  for (int i = 3; i < 40; ++i) AddGaussian({0.5, 0, kTableTop + 0.41 + 0.001 * i}, 5, &gaussians);
  EXPECT_TRUE(FindLayersOverTop(*top, stations, NothingIsThere, gaussians, {}).gaussians.empty());
}

// Points that turn for sure tell more of that than how high what goes is.
TEST_P(LayersOverTopTest, GoHoweverHighWherePointsOfThingsStay) {
  ASSERT_TRUE(top);
  Placement gaussians;
  for (double angle = 0; angle < 6; angle += 0.25) {
    for (const double height : {0.1, 0.45})
      AddGaussian({0.75 * std::cos(angle), 0.75 * std::sin(angle), kTableTop + height}, 5, &gaussians);
  }
  for (int i = 0; i < 48; ++i) AddGaussian({0.1, 0, kTableTop + 1.2 * kTablePixel}, 5, &gaussians);
  const auto find = [&](const std::vector<Eigen::Vector3d>& of_things) {
    return FindLayersOverTop(*top, stations, NothingIsThere, gaussians, of_things).gaussians.size();
  };
  EXPECT_EQ(find({}), 0U);
  // Half of what is judged goes: that much of five points is chance, and of six is three.
  std::vector<Eigen::Vector3d> of_things(5, {0.1, 0, kTableTop + 1.2 * kTablePixel});
  EXPECT_EQ(find(of_things), 0U);
  of_things.push_back(of_things.front());
  EXPECT_EQ(find(of_things), 48U);
  // One that goes is less than a tenth of ten and a half of 21 alone.
  of_things.back() = {0.75, 0, kTableTop + 0.1};
  of_things.resize(19, of_things.front());
  EXPECT_EQ(find(of_things), 0U);
  of_things.resize(21, of_things.front());
  EXPECT_EQ(find(of_things), 48U);
}

// A thing high over a table whose middle no light reaches, and layers between both.
class LayersInShadow : public testing::Test {
 protected:
  LayersInShadow() : scene(TableOnGround(kTablePhotos, TopLook::kPlain)), stations(LoadStations(scene)) {
    for (size_t i = 0; i < kTablePhotos; ++i) {
      // Nor a part of the ring next to the rim, by which the shadow is known.
      stations[0].images[i] = ShadeTop(
          stations[0].images[i], stations[0].views[i],
          [](const Eigen::Vector2d& x) { return x.norm() < 0.78 || x.x() < -0.5; }, {0.5, 0.55, 0.6});
    }
    for (double angle = 0; angle < 6; angle += 0.25)
      AddGaussian({0.55 * std::cos(angle), 0.55 * std::sin(angle), kTableTop + 0.08}, 5, &gaussians);
    num_layers = gaussians.size();
    for (int i = 0; i < 40; ++i) AddGaussian(thing + Eigen::Vector3d(0, 0, 0.001 * i), 5, &gaussians);
  }

  // \param color_of  by pixel.
  template <typename ColorOf>
  void Paint(const Eigen::Vector3d& what, size_t num_photos, const ColorOf& color_of) {
    for (size_t i = 0; i < num_photos; ++i) {
      const PinholeView& view = stations[0].views[i];
      const Eigen::Vector2d pixel = *PixelOf(view, view.cam_from_object * what);
      for (int y = static_cast<int>(pixel.y()) - 6; y <= static_cast<int>(pixel.y()) + 4; ++y) {
        for (int x = static_cast<int>(pixel.x()) - 4; x <= static_cast<int>(pixel.x()) + 4; ++x) {
          const std::array<uint8_t, 3> color = color_of(x, y);
          std::copy(color.begin(), color.end(), stations[0].images[i].Pixel(x, y));
        }
      }
    }
    stations[0].still = MedianPicture(stations[0].images);
  }

  // Some texture.
  static std::array<uint8_t, 3> OwnColor(int x, int y) {
    const auto grey = static_cast<uint8_t>(RandomBits(5, x, y).words[0] % 150 + 50);
    return {grey, static_cast<uint8_t>(grey / 2), 20};
  }

  std::vector<uint32_t> Find(const DepthsWithout& depths_without = NothingIsThere) const {
    const std::optional<PlainTop> top = PlainTop::Learn(stations, TableRegion());
    EXPECT_TRUE(top);
    return top ? FindLayersOverTop(*top, stations, depths_without, gaussians, of_things).gaussians
               : std::vector<uint32_t>();
  }

  const Eigen::Vector3d thing{0.3, 0, kTableTop + 0.41};
  TrainingScene scene;
  std::vector<StationPhotos> stations;
  Placement gaussians;
  std::vector<Eigen::Vector3d> of_things;
  size_t num_layers = 0;
};

// A table all of whose top has texture, layers over it, and a thing of another texture in each photo.
class LayersOverTexture : public testing::Test {
 protected:
  LayersOverTexture() : stations(LoadStations(TableOnGround(kTablePhotos, TopLook::kTiled))) {
    for (double angle = 0; angle < 6; angle += 0.25) {
      AddGaussian({0.6 * std::cos(angle), 0.6 * std::sin(angle), kTableTop + 0.1}, 5, &gaussians);
    }
    num_layers = gaussians.size();
    for (size_t i = 0; i < stations[0].views.size(); ++i) {
      const PinholeView& view = stations[0].views[i];
      const Eigen::Vector2d pixel = *PixelOf(view, view.cam_from_object * thing);
      for (int y = static_cast<int>(pixel.y()) - 8; y <= static_cast<int>(pixel.y()) + 8; ++y) {
        for (int x = static_cast<int>(pixel.x()) - 8; x <= static_cast<int>(pixel.x()) + 8; ++x) {
          const auto grey = static_cast<uint8_t>(RandomBits(40 + i, x / 3, y / 3).words[0] % 200 + 20);
          std::fill_n(stations[0].images[i].Pixel(x, y), 3, grey);
        }
      }
    }
  }

  std::vector<uint32_t> Find(const std::vector<std::vector<float>>& depths) const {
    const std::optional<TexturedTop> top = TexturedTop::Learn(stations, TableRegion());
    return top ? FindLayersOverTexture(*top, stations, depths, gaussians) : std::vector<uint32_t>();
  }

  const Eigen::Vector3d thing = {0.1, 0, kTableTop + 0.25};
  std::vector<StationPhotos> stations;
  Placement gaussians;
  size_t num_layers = 0;
};

TEST_F(LayersOverTexture, AreFoundAndAThingStays) {
  AddGaussian(thing, 5, &gaussians);
  AddGaussian({0.6, 0, kTableTop + 0.1}, -5, &gaussians);  // stands still
  AddGaussian({1.2, 0, kTableTop + 0.1}, 5, &gaussians);   // beside the table
  AddGaussian({0.6, 0, kTableTop + 0.5 * kTablePixel}, 5, &gaussians);
  std::vector<uint32_t> layers(num_layers);
  std::iota(layers.begin(), layers.end(), 0);
  EXPECT_EQ(Find(NothingHides()), layers);
  // Something else is no witness for what lies behind it, but the top's texture is one against all before it.
  EXPECT_EQ(Find(AllAt(1)), layers);
}

// As many of what is too high for a layer go for the same reason: things with the table's own pattern.
TEST_F(LayersOverTexture, StayWhereAThingGoesForTheTopsTexture) {
  for (double angle = 0; angle < 6; angle += 0.15)
    AddGaussian({0.95 * std::cos(angle), 0.95 * std::sin(angle), kTableTop + 0.41}, 5, &gaussians);
  EXPECT_TRUE(Find(NothingHides()).empty());
}

TEST(TopEvidence, SaysWhichSightsCount) {
  for (const TopSight sight : {TopSight::kElsewhere, TopSight::kOther, TopSight::kBorder}) {
    EXPECT_FALSE(IsTopSeen(sight, TopEvidence::kColors));
  }
  EXPECT_TRUE(IsTopSeen(TopSight::kShadow, TopEvidence::kColors));
  EXPECT_TRUE(IsTopSeen(TopSight::kLit, TopEvidence::kColors));
  EXPECT_TRUE(IsTopSeen(TopSight::kLit, TopEvidence::kLight));
  EXPECT_FALSE(IsTopSeen(TopSight::kShadow, TopEvidence::kLight));
  EXPECT_FALSE(IsTopSeen(TopSight::kLit, TopEvidence::kNone));
}

TEST_F(LayersInShadow, AreFoundBelowAThingOfItsOwnColors) {
  Paint(thing, kTablePhotos, OwnColor);
  std::vector<uint32_t> expected(num_layers);
  for (size_t i = 0; i < num_layers; ++i) expected[i] = static_cast<uint32_t>(i);
  EXPECT_EQ(Find(), expected);
  // Of what is so high nothing is left to judge shadows by.
  gaussians.centre.resize(3 * num_layers);
  gaussians.foreground_logit.resize(num_layers);
  EXPECT_TRUE(Find().empty());
}

// A side of a thing that looks like a shadow, but the thing's other sides would hide the top behind it.
TEST_F(LayersInShadow, StayWhereWhatStaysHidesTheTop) {
  Paint(thing, kTablePhotos, OwnColor);
  const DepthsWithout others_stay = [](const std::vector<uint32_t>& left_out) {
    return left_out.empty() ? NothingHides() : AllAt(1);
  };
  EXPECT_TRUE(Find(others_stay).empty());
  // What is at the top, or not before it, hides none of it.
  const DepthsWithout top_stays = [](const std::vector<uint32_t>& left_out) {
    return left_out.empty() ? NothingHides() : AllAt(100);
  };
  EXPECT_EQ(Find(top_stays).size(), num_layers);
}

// The first of them, which some photos show, stays only where something else hides the top behind it: it
// says nothing of the others, before which it stands.
TEST_F(LayersInShadow, LetEachOtherNotStay) {
  const Eigen::Vector3d first(gaussians.centre[0], gaussians.centre[1], gaussians.centre[2]);
  Paint(thing, kTablePhotos, OwnColor);
  Paint(first, 4, OwnColor);
  EXPECT_EQ(Find().size(), num_layers);
  const DepthsWithout first_stays = [&](const std::vector<uint32_t>& left_out) {
    if (left_out.empty()) return NothingHides();
    if (!std::binary_search(left_out.begin(), left_out.end(), 0U)) return AllAt(1);
    std::vector<std::vector<float>> depths = NothingHides();
    for (size_t i = 0; i < depths.size(); ++i) {
      const PinholeView& view = stations[0].views[i];
      const Eigen::Vector2d pixel = *PixelOf(view, view.cam_from_object * first);
      depths[i][static_cast<size_t>(pixel.y()) * view.width + static_cast<size_t>(pixel.x())] = 1;
    }
    return depths;
  };
  std::vector<uint32_t> others(num_layers - 1);
  std::iota(others.begin(), others.end(), 1);
  EXPECT_EQ(Find(first_stays), others);
}

// Texture as dark as a shadow is a border before the top, or a thing's in its own shadow.
TEST_F(LayersInShadow, StayWhereMorePhotosShowBordersThanShadows) {
  const Eigen::Vector3d first(gaussians.centre[0], gaussians.centre[1], gaussians.centre[2]);
  Paint(thing, kTablePhotos, OwnColor);
  const auto paint_borders = [&](size_t num_photos) {
    Paint(first, num_photos, [&](int x, int y) {
      const std::array<double, 3> umbra = {75, 82, 90};
      std::array<uint8_t, 3> color = {};
      for (int k = 0; k < 3; ++k)
        color[k] = static_cast<uint8_t>((x + y) % 2 == 0 ? umbra[k] : 0.5 * umbra[k]);
      return color;
    });
  };
  const auto is_first_found = [&] {
    const std::vector<uint32_t> found = Find();
    EXPECT_GT(found.size(), num_layers / 2);
    return !found.empty() && found.front() == 0;
  };
  paint_borders(4);
  EXPECT_TRUE(is_first_found());
  paint_borders(8);
  EXPECT_FALSE(is_first_found());
}

TEST_F(LayersInShadow, AreHiddenByNothingButWhatPhotosShow) {
  Paint(thing, kTablePhotos, OwnColor);
  const auto at_top = static_cast<uint32_t>(gaussians.size());
  AddGaussian({0.5, 0.2, kTableTop}, 5, &gaussians);
  AddGaussian({0, 0, kTableTop + 1}, 5, &gaussians);  // before the ground, where no photo tells
  std::vector<uint32_t> expected(num_layers);
  std::iota(expected.begin(), expected.end(), 0);
  expected.push_back(at_top);
  expected.push_back(at_top + 1);
  std::vector<std::vector<uint32_t>> asked;
  Find([&](const std::vector<uint32_t>& left_out) {
    asked.push_back(left_out);
    return NothingHides();
  });
  ASSERT_GE(asked.size(), 2U);
  EXPECT_EQ(asked[1], expected);
}

// The top's own light is seen by chance in hardly any photo of a thing, whatever is behind.
TEST_P(LayersOverTopTest, AreFoundByLightBeforeWhatStays) {
  ASSERT_TRUE(top);
  Placement gaussians;
  for (double angle = 0; angle < 6; angle += 0.25)
    AddGaussian({0.75 * std::cos(angle), 0.75 * std::sin(angle), kTableTop + 0.1}, 5, &gaussians);
  const DepthsWithout others_stay = [](const std::vector<uint32_t>& left_out) {
    return left_out.empty() ? NothingHides() : AllAt(1);
  };
  EXPECT_EQ(FindLayersOverTop(*top, stations, others_stay, gaussians, {}).gaussians.size(), gaussians.size());
}

TEST(HiddenShadows, AreForgottenAndNothingElse) {
  const std::vector<StationPhotos> stations = LoadStations(TableOnGround(kTablePhotos, TopLook::kPlain));
  const PinholeView& view = stations[0].views[0];
  RotatingRegion flat = TableRegion();
  flat.low = flat.high;
  const RegionView top(flat, view);
  const size_t count = static_cast<size_t>(view.width) * view.height;
  size_t num_hidden = 0;
  for (const double off : {-0.5, -0.01, 0.5}) {  // of the top, along the camera's axis
    std::vector<float> depths(count, 0);
    std::vector<TopSight> sights(count, TopSight::kShadow);
    std::vector<TopSight> expected = sights;
    for (size_t p = 0; p < count; ++p) {
      const std::optional<RegionHit> hit =
          top.At(static_cast<int>(p % view.width), static_cast<int>(p / view.width));
      if (p % 3 == 0) continue;  // nothing is there
      depths[p] = static_cast<float>((hit ? hit->depth : 4) + off);
      if (p % 3 == 1) {
        sights[p] = expected[p] = TopSight::kLit;
      } else if (hit && off == -0.5) {
        expected[p] = TopSight::kElsewhere;
        ++num_hidden;
      }
    }
    ForgetHiddenShadows(TableRegion(), view, depths, &sights);
    EXPECT_EQ(sights, expected) << off;
  }
  EXPECT_GT(num_hidden, 500U);
}

// However low it is, where points of it look so.
TEST_F(LayersInShadow, StayWherePointsOfThingsLookLikeAShadow) {
  Paint(thing, kTablePhotos, OwnColor);
  of_things.assign(10, thing);
  EXPECT_EQ(Find().size(), num_layers);
  for (int i = 0; i < 3; ++i)
    of_things[static_cast<size_t>(i)] = {gaussians.centre[0], gaussians.centre[1], gaussians.centre[2]};
  EXPECT_TRUE(Find().empty());
}

TEST_F(LayersInShadow, StayBelowAThingThatLooksLikeAShadow) {
  Paint(thing, kTablePhotos, [](int, int) { return std::array<uint8_t, 3>{75, 82, 90}; });
  EXPECT_TRUE(Find().empty());
}

}  // namespace
}  // namespace s2gs
