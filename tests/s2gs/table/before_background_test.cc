#include "s2gs/table/before_background.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

#include "sfm_split/base/angles.h"

namespace s2gs {
namespace {

constexpr int kSide = 80;        // [px]
constexpr int kHalf = 3;         // of what a Gaussian covers [px]
constexpr double kAway = 4;      // of the camera from the axis
constexpr uint8_t kColor = 250;  // of what turns

// A camera that stands still before a pattern, and points about the z axis that turn.
class TurningPoints {
 public:
  explicit TurningPoints(int num_photos, bool is_plain = false) : random_(1) {
    Rigid3 cam_from_world;
    cam_from_world.rotation = Eigen::AngleAxisd(kPi / 2, Eigen::Vector3d::UnitX());
    cam_from_world.translation = {0, 0, kAway};
    std::vector<uint8_t> pattern;
    for (int i = 0; i < kSide * kSide * 3; ++i)
      pattern.push_back(static_cast<uint8_t>(is_plain ? 100 : Uniform(20, 180)));
    for (int i = 0; i < num_photos; ++i) {
      PinholeView view{kSide, kSide, 80, 80, kSide / 2.0, kSide / 2.0, cam_from_world, cam_from_world};
      const Eigen::AngleAxisd turn(2 * kPi * i / num_photos, Eigen::Vector3d::UnitZ());
      view.cam_from_object.rotation = cam_from_world.rotation * turn;
      Image8 image{kSide, kSide, 3, pattern};
      for (uint8_t& value : image.pixels) value = static_cast<uint8_t>(value + Uniform(-3, 3));
      station_.views.push_back(view);
      station_.images.push_back(std::move(image));
      masks_.push_back({kSide, kSide, std::vector<uint8_t>(size_t{kSide} * kSide, 0)});
    }
  }

  // A rotating Gaussian, which masks show; photos only where it is there.
  void Add(const Eigen::Vector3d& x, bool is_there, bool rotates = true) {
    for (int k = 0; k < 3; ++k) gaussians_.centre.push_back(static_cast<float>(x[k]));
    gaussians_.foreground_logit.push_back(rotates ? 5 : -5);
    for (size_t i = 0; i < station_.views.size(); ++i) {
      const PinholeView& view = station_.views[i];
      const Eigen::Vector2d at = *PixelOf(view, view.cam_from_object * x);
      for (int v = static_cast<int>(at.y()) - kHalf; v <= static_cast<int>(at.y()) + kHalf; ++v) {
        for (int u = static_cast<int>(at.x()) - kHalf; u <= static_cast<int>(at.x()) + kHalf; ++u) {
          masks_[i].inside[v * kSide + u] = 1;
          for (int c = 0; is_there && c < 3; ++c) station_.images[i].pixels[3 * (v * kSide + u) + c] = kColor;
        }
      }
    }
  }

  // Of the uppermost rows in the first photos, as where somebody passes.
  void Brighten(int num_rows, size_t num_photos, int by) {
    for (size_t i = 0; i < num_photos; ++i) {
      for (int k = 0; k < 3 * kSide * num_rows; ++k)
        station_.images[i].pixels[k] = static_cast<uint8_t>(station_.images[i].pixels[k] + by);
    }
  }

  std::vector<uint32_t> Find() const { return FindShowingBackground({station_}, {masks_}, gaussians_); }

 private:
  int Uniform(int low, int high) { return std::uniform_int_distribution<>(low, high)(random_); }

  std::mt19937 random_;
  StationPhotos station_;
  std::vector<PixelMask> masks_;
  Placement gaussians_;
};

TEST(BeforeBackground, WhatPhotosDoNotShowIsFound) {
  TurningPoints scene(16);
  for (int i = 0; i < 5; ++i) scene.Add({std::cos(1.2 * i), std::sin(1.2 * i), 0.3 * i - 0.6}, true);
  scene.Add({0.8, 0.9, 0.9}, false);
  scene.Add({-0.9, 0.9, -0.9}, false);
  EXPECT_EQ(scene.Find(), (std::vector<uint32_t>{5, 6}));
}

TEST(BeforeBackground, WhatDoesNotRotateIsNotAsked) {
  TurningPoints scene(16);
  for (int i = 0; i < 5; ++i) scene.Add({std::cos(1.2 * i), std::sin(1.2 * i), 0.3 * i - 0.6}, true);
  scene.Add({0.8, 0.9, 0.9}, false, false);
  EXPECT_TRUE(scene.Find().empty());
}

// On the axis a mask covers the same pixels in all photos; and where photos show nothing that turns, none
// tells what is there.
TEST(BeforeBackground, WhatNothingTellsStays) {
  TurningPoints axis(16);
  for (int i = 0; i < 5; ++i) axis.Add({std::cos(1.2 * i), std::sin(1.2 * i), 0.3 * i - 0.6}, true);
  axis.Add({0, 0, 1}, false);
  EXPECT_TRUE(axis.Find().empty());
  TurningPoints none(16);
  for (int i = 0; i < 5; ++i) none.Add({std::cos(1.2 * i), std::sin(1.2 * i), 0.3 * i - 0.6}, false);
  EXPECT_TRUE(none.Find().empty());
  EXPECT_TRUE(FindShowingBackground({}, {}, Placement()).empty());
}

// What is about such pixels tells a plain wall there, of what is not there and of what is.
TEST(BeforeBackground, PlainSurroundingsTellWhatNoPhotoShows) {
  for (const bool is_there : {false, true}) {
    TurningPoints axis(16, true);
    for (int i = 0; i < 5; ++i) axis.Add({std::cos(1.2 * i), std::sin(1.2 * i), 0.3 * i - 0.6}, true);
    axis.Add({0, 0, 1}, is_there);
    EXPECT_EQ(axis.Find(), is_there ? std::vector<uint32_t>() : std::vector<uint32_t>{5});
  }
  TurningPoints none(16, true);
  for (int i = 0; i < 5; ++i) none.Add({std::cos(1.2 * i), std::sin(1.2 * i), 0.3 * i - 0.6}, false);
  EXPECT_TRUE(none.Find().empty());
}

// What is about them differs from photo to photo by as much as what turns does from it: that tells nothing.
TEST(BeforeBackground, SurroundingsThatDifferFromPhotoToPhotoDoNot) {
  for (const int by : {0, 152}) {
    TurningPoints axis(16, true);
    for (int i = 0; i < 5; ++i) axis.Add({std::cos(1.2 * i), std::sin(1.2 * i), 0.3 * i - 0.6}, true);
    axis.Add({0, 0, 1.5}, false);
    axis.Brighten(20, 4, by);
    EXPECT_EQ(axis.Find(), by == 0 ? std::vector<uint32_t>{5} : std::vector<uint32_t>());
  }
}

}  // namespace
}  // namespace s2gs
