#include "sfm_split/pictures/tile_motion.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <random>
#include <vector>

namespace s2gs {
namespace {

constexpr int kPictureWidth = 480;
constexpr int kPictureHeight = 360;

// Tiles over the picture, found again where a map takes them, but for noise.
template <typename Map>
std::vector<TileMatch> Tiles(const Map& map) {
  std::mt19937 random(1);
  std::normal_distribution<double> noise(0, 0.05);
  std::vector<TileMatch> tiles;
  for (int y = 12; y < kPictureHeight; y += 24) {
    for (int x = 12; x < kPictureWidth; x += 24) {
      TileMatch tile;
      tile.centre = {x, y};
      tile.is_textured = tile.is_found = true;
      tile.correlation = 0.95;
      tile.sigma_px = 0.07;
      tile.displacement = map(tile.centre) - tile.centre + Eigen::Vector2d(noise(random), noise(random));
      tiles.push_back(tile);
    }
  }
  return tiles;
}

Eigen::Vector2d Moved(const Eigen::Matrix3d& H, const Eigen::Vector2d& xy) {
  return (H * xy.homogeneous()).hnormalized();
}

// Turned about the picture's axes and the line of sight [rad].
Eigen::Matrix3d TurnOfCamera(double focal_px, const Eigen::Vector3d& turn) {
  Eigen::Matrix3d K;
  K << focal_px, 0, 0.5 * kPictureWidth, 0, focal_px, 0.5 * kPictureHeight, 0, 0, 1;
  return K * Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix() * K.inverse();
}

double MostDifference(const Eigen::Matrix3d& a, const Eigen::Matrix3d& b) {
  double most = 0;
  for (const Eigen::Vector2d& xy :
       {Eigen::Vector2d(0, 0), Eigen::Vector2d(kPictureWidth, 0), Eigen::Vector2d(0, kPictureHeight),
        Eigen::Vector2d(kPictureWidth, kPictureHeight),
        Eigen::Vector2d(kPictureWidth / 2, kPictureHeight / 2)})
    most = std::max(most, (Moved(a, xy) - Moved(b, xy)).norm());
  return most;
}

// Measured at the picture's middle and corners: .024 px at most.
TEST(FitTileMotion, FindsHowACameraTurned) {
  for (const double focal_px : {300, 480, 1400}) {
    for (const Eigen::Vector3d& px :
         {Eigen::Vector3d(1, 0, 0), Eigen::Vector3d(-3, 6, 0), Eigen::Vector3d(2, 9, 1.5)}) {
      const Eigen::Matrix3d H = TurnOfCamera(focal_px, px / focal_px);
      const auto tiles = Tiles([&](const Eigen::Vector2d& xy) { return Moved(H, xy); });
      EXPECT_LT(MostDifference(FitTileMotion(tiles, kPictureWidth, kPictureHeight), H), 0.05)
          << focal_px << ": " << px.transpose();
    }
  }
}

TEST(FitTileMotion, ThatNothingMoved) {
  const auto tiles = Tiles([](const Eigen::Vector2d& xy) { return xy; });
  EXPECT_EQ(FitTileMotion(tiles, kPictureWidth, kPictureHeight), Eigen::Matrix3d::Identity());
}

// Eleven tiles are too few for an affine map. Measured .11 px; by a shift alone 1.9 px are left.
TEST(FitTileMotion, FindsARollThatFewTilesTell) {
  const Eigen::Matrix3d H = TurnOfCamera(960, Eigen::Vector3d(1.5, 2, 5) / 960);
  const auto all = Tiles([&](const Eigen::Vector2d& xy) { return Moved(H, xy); });
  std::vector<TileMatch> few;
  for (size_t t = 0; t < all.size() && few.size() < 11; t += 27) few.push_back(all[t]);
  ASSERT_EQ(few.size(), 11U);
  EXPECT_LT(MostDifference(FitTileMotion(few, kPictureWidth, kPictureHeight), H), 0.25);
}

// A lens that focuses anew.
TEST(FitTileMotion, FindsGrowth) {
  const Eigen::Vector2d middle(0.5 * kPictureWidth, 0.5 * kPictureHeight);
  const auto tiles = Tiles([&](const Eigen::Vector2d& xy) { return middle + 1.006 * (xy - middle); });
  const Eigen::Matrix3d H = FitTileMotion(tiles, kPictureWidth, kPictureHeight);
  EXPECT_LT((Moved(H, {0, 0}) - Eigen::Vector2d(-0.006 * middle)).norm(), 0.1);
}

}  // namespace
}  // namespace s2gs
