#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cmath>
#include <cstdint>
#include <functional>
#include <numeric>
#include <vector>

#include "s2gs/table/layers_over_top.h"
#include "s2gs/table/opaque_region.h"
#include "tests/s2gs/table/table_on_ground.h"

namespace s2gs {
namespace {

// A wall of rotating Gaussians on the rim, and a thing on the axis that looks alike as it turns, before
// smooth ground.
class StandingOverTopTest : public testing::Test {
 protected:
  StandingOverTopTest() : scene(TableOnGround(kTablePhotos, TopLook::kPlain)) {
    for (double angle = 0; angle < 6; angle += 0.25)
      AddGaussian({0.95 * std::cos(angle), 0.95 * std::sin(angle), kTableTop + 0.2}, 5, &gaussians);
    num_wall = gaussians.size();
    for (int i = 0; i < 40; ++i) AddGaussian({0, 0, kTableTop + 0.45 + 0.001 * i}, 5, &gaussians);
  }

  // \param red, blue  of the ground at the picture's column, which is no table's, from 0 to 1.
  void Paint(const std::function<double(double)>& red, const std::function<double(double)>& blue) {
    for (ScenePhoto& photo : scene.photos) {
      PixelMask table{photo.image.width, photo.image.height, {}};
      table.inside.assign(photo.image.pixels.size() / 3, 0);
      AddRegion(TableRegion(), photo.view, &table);
      AddRegion({TurntableAxis(), 0.15, kTableTop, kTableTop + 0.6}, photo.view, &table);
      for (size_t i = 0; i < table.inside.size(); ++i) {
        if (table.inside[i] != 0) continue;
        const double column = static_cast<double>(i % kTablePhotoWidth) / kTablePhotoWidth;
        photo.image.pixels[3 * i] = static_cast<uint8_t>(red(column));
        photo.image.pixels[3 * i + 1] = 120;
        photo.image.pixels[3 * i + 2] = static_cast<uint8_t>(blue(column));
      }
    }
    stations = LoadStations(scene);
  }

  void ShowEverySecondOfWall(size_t photo) {
    const PinholeView& view = stations[0].views[photo];
    for (size_t k = 0; k < num_wall; k += 2) {
      const float* x = &gaussians.centre[3 * k];
      const Eigen::Vector2d pixel = *PixelOf(view, view.cam_from_object * Eigen::Vector3d(x[0], x[1], x[2]));
      uint8_t* color =
          stations[0].images[photo].Pixel(static_cast<int>(pixel.x()), static_cast<int>(pixel.y()));
      color[0] = color[1] = 230;
      color[2] = 20;
    }
  }

  std::vector<uint32_t> Find() const {
    const StandingOverTop found =
        FindStandingOverTop(TableRegion(), stations, NothingHides(), gaussians, of_things);
    return found.spares_things ? found.gaussians : std::vector<uint32_t>();
  }

  TrainingScene scene;
  std::vector<StationPhotos> stations;
  Placement gaussians;
  std::vector<Eigen::Vector3d> of_things;
  size_t num_wall = 0;
};

TEST_F(StandingOverTopTest, IsKnownByTheTintOfTheGroundBehind) {
  Paint([](double column) { return 60 + 120 * column; }, [](double column) { return 180 - 120 * column; });
  std::vector<uint32_t> wall(num_wall);
  std::iota(wall.begin(), wall.end(), 0);
  EXPECT_EQ(Find(), wall);
  EXPECT_TRUE(FindStandingOverTop(TableRegion(), {}, {}, gaussians, {}).gaussians.empty());

  // What is known to be before it says nothing of it.
  EXPECT_TRUE(FindStandingOverTop(TableRegion(), stations, AllAt(1), gaussians, {}).gaussians.empty());

  // Nor can a thing be told from it that is so high and goes for the same reason.
  for (double angle = 0; angle < 6; angle += 0.25)
    AddGaussian({0.95 * std::cos(angle), 0.95 * std::sin(angle), kTableTop + 0.45}, 5, &gaussians);
  EXPECT_TRUE(Find().empty());
}

// Points that turn for sure tell whether the same would take things, however high what goes is.
TEST_F(StandingOverTopTest, IsHighWherePointsOfThingsStay) {
  Paint([](double column) { return 60 + 120 * column; }, [](double column) { return 180 - 120 * column; });
  for (double angle = 0; angle < 6; angle += 0.25)
    AddGaussian({0.95 * std::cos(angle), 0.95 * std::sin(angle), kTableTop + 0.45}, 5, &gaussians);
  std::vector<uint32_t> both(num_wall);
  std::iota(both.begin(), both.end(), 0);
  for (size_t i = num_wall + 40; i < gaussians.size(); ++i) both.push_back(static_cast<uint32_t>(i));
  ASSERT_EQ(both.size(), 2 * num_wall);

  // If all that goes, 48 of 88, were things', 3.3 of 6 points would go with it, and 2.7 of 5, which may be 0
  // by chance.
  for (int i = 0; i < 5; ++i) of_things.emplace_back(0, 0, kTableTop + 0.45 + 0.005 * i);
  EXPECT_TRUE(Find().empty());
  EXPECT_EQ(FindStandingOverTop(TableRegion(), stations, NothingHides(), gaussians, of_things).gaussians,
            both);
  of_things.emplace_back(0, 0, kTableTop + 0.48);
  EXPECT_EQ(Find(), both);

  // Points below or on the top say nothing. One that goes is a tenth of 9.8 of 18, and of 10.4 of 19 less.
  of_things.emplace_back(0.95, 0, kTableTop);
  EXPECT_EQ(Find(), both);
  of_things.back().z() = kTableTop + 0.3;
  of_things.resize(18, of_things.front());
  EXPECT_TRUE(Find().empty());
  of_things.push_back(of_things.front());
  EXPECT_EQ(Find(), both);
}

// Light may fall on a thing that turns as it does on that ground.
TEST_F(StandingOverTopTest, IsNotKnownByGreyGround) {
  Paint([](double) { return 120; }, [](double) { return 120; });
  EXPECT_TRUE(Find().empty());
}

// Photos show the wall, of one tint, or more of them do than show another tint behind it.
TEST_F(StandingOverTopTest, IsNotWhatMorePhotosShowTurning) {
  for (const bool in_all : {true, false}) {
    Paint([](double column) { return 60 + 120 * column; }, [](double column) { return 180 - 120 * column; });
    for (size_t i = 0; i < kTablePhotos; ++i) {
      if (in_all || i % 3 != 2) ShowEverySecondOfWall(i);
    }
    for (const uint32_t i : Find()) EXPECT_EQ(i % 2, 1U);
    EXPECT_GT(Find().size(), num_wall / 3);
  }
}

}  // namespace
}  // namespace s2gs
