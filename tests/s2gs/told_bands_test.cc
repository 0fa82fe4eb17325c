#include "s2gs/told_bands.h"

#include <gtest/gtest.h>

#include <cmath>
#include <utility>

#include "sfm_split/base/angles.h"
#include "tests/s2gs/small_scene.h"

namespace s2gs {
namespace {

constexpr double kBand1 = 0.4886025119029199;  // sqrt(3 / (4 pi))

// Spread evenly over an arc in the plane of x and y.
std::vector<Eigen::Vector3d> Arc(int count, double degrees) {
  std::vector<Eigen::Vector3d> directions;
  for (int i = 0; i < count; ++i) {
    const double angle = kPi / 180 * degrees * ((i + 0.5) / count - 0.5);
    directions.emplace_back(std::cos(angle), std::sin(angle), 0);
  }
  return directions;
}

TEST(ToldBands, OwnPartsAreThoseOfClosedForms) {
  // From one side a constant does all.
  for (const BandEvidence& band : MeasureBands({{0, 0.6, 0.8}}, 3)) EXPECT_LT(band.own_part, 1e-12);
  // From two opposite sides the first band is odd, the second even.
  const auto opposite = MeasureBands({{1, 0, 0}, {-1, 0, 0}}, 3);
  EXPECT_NEAR(opposite[0].own_part, kBand1, 1e-12);
  EXPECT_LT(opposite[1].own_part, 1e-12);
  EXPECT_LT(opposite[2].own_part, 1e-12);
  // Around a circle band l adds cos l phi and sin l phi: the largest coefficient of each times its RMS,
  // 1 / sqrt(2). Y_22 has .5463 sin^2, Y_33 .5900 sin^3 of the polar angle, which is 1 here.
  const auto circle = MeasureBands(Arc(36, 360), 3);
  EXPECT_NEAR(circle[0].own_part, kBand1 / std::sqrt(2.0), 1e-12);
  EXPECT_NEAR(circle[1].own_part, 0.5462742152960396 / std::sqrt(2.0), 1e-12);
  EXPECT_NEAR(circle[2].own_part, 0.5900435899266435 / std::sqrt(2.0), 1e-12);
  // Over a short arc the first band is the sine of the angle from its middle.
  const double half = kPi / 180 * 4;
  EXPECT_NEAR(MeasureBands(Arc(2000, 8), 1)[0].own_part,
              kBand1 * std::sqrt(0.5 - std::sin(2 * half) / (4 * half)), 1e-6 * half);
}

TEST(ToldBands, AWholeTurnTellsAllAndOneSideNone) {
  TrainingScene scene = MakeSmallScene(TrainMode::kS2gs, 32, 24, 1, 12);
  EXPECT_EQ(FindToldBands(scene, 3).degree, 3);
  EXPECT_EQ(FindToldBands(scene, 1).degree, 1);
  // The same photo again and again.
  for (ScenePhoto& photo : scene.photos) photo.view = scene.photos[0].view;
  const ToldBands told = FindToldBands(scene, 3);
  EXPECT_EQ(told.degree, 0);
  EXPECT_EQ(told.last.band, 1);
  EXPECT_LT(told.last.own_part, kGreyLevel);
}

// Photos of what turns from one side before a background that is seen from all of them: what counts are the
// bodies that are trained.
TEST(ToldBands, AreThoseOfTheBodiesThatAreTrained) {
  TrainingScene scene = MakeSmallScene(TrainMode::kS2gs, 32, 24, 1, 12);
  for (ScenePhoto& photo : scene.photos) {
    photo.view.cam_from_world = photo.view.cam_from_object;
    photo.view.cam_from_object = scene.photos[0].view.cam_from_object;
  }
  EXPECT_EQ(FindToldBands(scene, 3).degree, 3);
  scene.mode = TrainMode::kStatic;
  EXPECT_EQ(FindToldBands(scene, 3).degree, 3);
  scene.mode = TrainMode::kMasks;
  EXPECT_EQ(FindToldBands(scene, 3).degree, 0);
  for (ScenePhoto& photo : scene.photos) std::swap(photo.view.cam_from_world, photo.view.cam_from_object);
  EXPECT_EQ(FindToldBands(scene, 3).degree, 3);
  scene.mode = TrainMode::kStatic;
  EXPECT_EQ(FindToldBands(scene, 3).degree, 0);
  scene.mode = TrainMode::kS2gs;
  EXPECT_EQ(FindToldBands(scene, 3).degree, 3);
}

}  // namespace
}  // namespace s2gs
