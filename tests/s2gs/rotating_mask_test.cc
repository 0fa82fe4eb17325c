#include "s2gs/rotating_mask.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "sfm_split/base/angles.h"
#include "tests/s2gs/backend/reference_render.h"

namespace s2gs {
namespace {

constexpr int kSize = 60;          // [px]
constexpr double kFocal = 60;      // [px]
constexpr double kDistance = 4;    // of the camera above the disc.
constexpr double kDiscRadius = 1;  // 15 px in the view

// A round splat that faces the camera, which looks down along -z.
ReferenceGaussian Splat(double x, double y, double z, double scale, bool rotates) {
  ReferenceGaussian g{};
  g[kRefCentre] = x;
  g[kRefCentre + 1] = y;
  g[kRefCentre + 2] = z;
  g[kRefLogScale] = g[kRefLogScale + 1] = std::log(scale);
  g[kRefRotation] = 1;
  g[kRefOpacity] = 8;
  g[kRefForeground] = rotates ? 10 : -10;
  return g;
}

// A disc of rotating splats on a static ground.
std::vector<ReferenceGaussian> DiscOnGround() {
  std::vector<ReferenceGaussian> scene;
  constexpr double kStep = 0.05;
  for (int i = -40; i <= 40; ++i) {
    for (int j = -40; j <= 40; ++j) {
      const double x = i * kStep;
      const double y = j * kStep;
      scene.push_back(Splat(x, y, -0.5, kStep, false));
      if (std::hypot(x, y) <= kDiscRadius) scene.push_back(Splat(x, y, 0, kStep / 2, true));
    }
  }
  return scene;
}

TrainingScene TurntableScene(int num_stations) {
  TrainingScene scene;
  scene.mode = TrainMode::kS2gs;
  scene.axis = TurntableAxis();
  scene.region = RotatingRegion{TurntableAxis(), 1.15 * kDiscRadius, -0.25, 0.25};
  for (int station = 0; station < num_stations; ++station) {
    ScenePhoto photo;
    photo.station = station;
    PinholeView& view = photo.view;
    view.width = view.height = kSize;
    view.fx = view.fy = kFocal;
    view.cx = view.cy = kSize / 2.0;
    view.cam_from_world = {Eigen::Quaterniond(Eigen::AngleAxisd(kPi, Eigen::Vector3d::UnitX())),
                           {0, 0, kDistance}};
    view.cam_from_object = view.cam_from_world;
    scene.photos.push_back(photo);
  }
  return scene;
}

PixelMask MaskOf(const std::vector<ReferenceGaussian>& splats, const TrainingScene& scene) {
  const std::unique_ptr<Backend> backend = MakeCpuBackend(1);
  TrainState state;
  state.gaussians = FromReference(splats, 0);
  backend->SetState(state);
  const std::optional<RotatingShape> shape = FindRotatingShape(scene, state.gaussians);
  return RotatingMask(backend->Render(MaskRequest(scene, shape, scene.photos[0].view)));
}

bool IsInside(const PixelMask& mask, int x, int y) {
  return mask.inside[static_cast<size_t>(y) * kSize + static_cast<size_t>(x)] != 0;
}

int64_t Area(const PixelMask& mask) {
  int64_t area = 0;
  for (const uint8_t inside : mask.inside) area += inside;
  return area;
}

// A static shadow of radius .3 on the disc, 7 px right of its middle.
void AddShadow(double z, std::vector<ReferenceGaussian>* splats) {
  for (int i = -6; i <= 6; ++i) {
    for (int j = -6; j <= 6; ++j) splats->push_back(Splat(0.5 + 0.05 * i, 0.05 * j, z, 0.05, false));
  }
}

TEST(RotatingMask, WhatRotatesInARegionIsFoundByItsCentre) {
  const RotatingRegion region{TurntableAxis(), 1, -0.1, 0.1};
  const Placement gaussians{{0.9F, 0, 0, 0.9F, 0, 0, 0, 0, 0.2F, 0, 1.1F, 0, 0, -0.9F, -0.09F},
                            {5, -5, 5, 5, 5}};
  EXPECT_EQ(FindRotatingIn(region, 0, gaussians), (std::vector<uint32_t>{0, 4}));
  EXPECT_EQ(FindRotatingIn(region, 0.11, gaussians), (std::vector<uint32_t>{0, 2, 3, 4}));
}

// One that is long and lies along x, and across it.
TEST(RotatingMask, WhatReachesOutOfTheRegionShowsTheGround) {
  const RotatingRegion region{TurntableAxis(), 1, -0.1, 0.1};
  ReferenceGaussian inwards = Splat(0.9, 0, 0, 0.05, true);
  inwards[kRefLogScale + 1] = std::log(0.4);  // to .98 from the axis
  ReferenceGaussian outwards = inwards;
  outwards[kRefRotation] = outwards[kRefRotation + 3] = std::sqrt(0.5);  // a quarter turn about z: to 1.3
  ReferenceGaussian stands = outwards;
  stands[kRefForeground] = -10;
  const ReferenceGaussian high = Splat(0, 0, 0.5, 0.4, true);
  ReferenceGaussian to_minus_x = outwards;
  to_minus_x[kRefCentre] = -0.9;
  const Gaussians gaussians = FromReference({inwards, outwards, stands, high, to_minus_x}, 0);
  EXPECT_EQ(FindReachingOut(region, gaussians), (std::vector<uint32_t>{1, 4}));
}

TEST(RotatingMask, IsTheDisc) {
  const PixelMask mask = MaskOf(DiscOnGround(), TurntableScene(2));
  EXPECT_TRUE(IsInside(mask, 30, 30));
  EXPECT_FALSE(IsInside(mask, 30, 10));
  // 15 px of radius and about one standard deviation of the outer splats.
  EXPECT_NEAR(std::sqrt(static_cast<double>(Area(mask)) / kPi), 15.3, 0.5);
}

TEST(RotatingMask, HasNoHolesWhereShadowsStandOnTheDisc) {
  const int64_t area = Area(MaskOf(DiscOnGround(), TurntableScene(2)));
  for (const double height : {0.01, 0.2}) {
    std::vector<ReferenceGaussian> splats = DiscOnGround();
    AddShadow(height, &splats);
    const PixelMask mask = MaskOf(splats, TurntableScene(2));
    EXPECT_TRUE(IsInside(mask, 37, 30));
    EXPECT_EQ(Area(mask), area);
  }
}

TEST(RotatingMask, EndsAtWhatStandsBeforeTheTable) {
  std::vector<ReferenceGaussian> splats = DiscOnGround();
  AddShadow(1.5, &splats);
  const PixelMask mask = MaskOf(splats, TurntableScene(2));
  EXPECT_FALSE(IsInside(mask, 41, 30));
  EXPECT_TRUE(IsInside(mask, 22, 30));
}

constexpr double kSideEnd = -0.06;       // of what rotates,
constexpr double kSideStaticEnd = -0.1;  // and of the static splats that continue it.

// The disc's rim before the camera of SideScene: top and side down to kSideEnd rotate; static splats of
// `color` (band 0) go on below.
std::vector<ReferenceGaussian> DiscWithStaticEnd(double color, bool stands = true) {
  std::vector<ReferenceGaussian> scene;
  constexpr double kStep = 0.01;
  for (int i = -30; i <= 30; ++i) {
    const double x = i * kStep;
    for (int j = -100; j <= 100; ++j) {
      if (std::hypot(x, j * kStep) <= kDiscRadius) scene.push_back(Splat(x, j * kStep, 0, kStep / 2, true));
    }
    for (double z = 0; z > kSideStaticEnd - 0.1 * kStep; z -= kStep) {
      const bool rotates = z > kSideEnd - 0.1 * kStep;
      ReferenceGaussian g = Splat(x, -std::sqrt(1 - x * x), z, kStep / 2, rotates);
      if (rotates || stands) g[kRefRotation] = g[kRefRotation + 1] = std::sqrt(0.5);  // faces the camera
      if (!rotates) g[kRefDc] = g[kRefDc + 1] = g[kRefDc + 2] = color;
      scene.push_back(g);
    }
  }
  return scene;
}

// A camera at the height of the disc's top, 150 px to a unit of length at the rim.
TrainingScene SideScene() {
  TrainingScene scene = TurntableScene(2);
  for (ScenePhoto& photo : scene.photos) {
    PinholeView& view = photo.view;
    view.fx = view.fy = 450;
    Eigen::Matrix3d rotation;
    rotation << 1, 0, 0, 0, 0, -1, 0, 1, 0;
    view.cam_from_world = {Eigen::Quaterniond(rotation), {0, 0, kDistance}};
    view.cam_from_object = view.cam_from_world;
  }
  return scene;
}

TEST(RotatingMask, FindsTheLowerEndOfTheDisc) {
  const TrainingScene scene = SideScene();
  const std::optional<RotatingShape> shape =
      FindRotatingShape(scene, FromReference(DiscWithStaticEnd(0.2), 0));
  ASSERT_TRUE(shape && shape->side);
  EXPECT_NEAR(shape->swept.low, kSideEnd, 1e-6);
  EXPECT_NEAR(shape->swept.high, scene.region->high, 1e-12);
  EXPECT_NEAR(shape->swept.radius, 1.01 * kDiscRadius, 1e-3);
  EXPECT_NEAR(shape->side->color[0], 0.5, 1e-6);
}

// Everything is measured in radii of the disc: twice the scene has twice the lengths.
TEST(RotatingMask, LengthsOfTheSideAreSharesOfTheDiscsRadius) {
  for (const double scale : {1.0, 2.0, 0.25}) {
    TrainingScene scene = SideScene();
    scene.region = RotatingRegion{TurntableAxis(), scale * scene.region->radius, scale * scene.region->low,
                                  scale * scene.region->high};
    std::vector<ReferenceGaussian> splats = DiscWithStaticEnd(0.2);
    for (ReferenceGaussian& splat : splats) {
      for (int i = 0; i < 3; ++i) splat[kRefCentre + i] *= scale;
      for (int i = 0; i < 2; ++i) splat[kRefLogScale + i] += std::log(scale);
    }
    const std::optional<RotatingShape> shape = FindRotatingShape(scene, FromReference(splats, 0));
    ASSERT_TRUE(shape && shape->side) << scale;
    const double radius = shape->swept.radius / 1.01;
    EXPECT_NEAR(radius, scale * kDiscRadius, 1e-3 * scale);
    EXPECT_NEAR(shape->swept.low, scale * kSideEnd, 1e-6 * scale);
    EXPECT_NEAR(shape->side->region.radius, 1.02 * radius, 1e-6 * scale);
    EXPECT_NEAR(shape->side->inner_radius, 0.95 * radius, 1e-6 * scale);
    EXPECT_NEAR(shape->side->region.low, scale * kSideEnd - 0.04 * radius, 1e-6 * scale);
    EXPECT_NEAR(shape->side->region.high, scale * kSideEnd + 0.08 * radius, 1e-6 * scale);
    EXPECT_FLOAT_EQ(shape->side->color_tolerance, 0.1F);
  }
}

TEST(RotatingMask, WhatLiesBesideTheSideDoesNotCount) {
  std::vector<ReferenceGaussian> splats = DiscWithStaticEnd(0.1);
  for (int i = 0; i < 2000; ++i) {
    ReferenceGaussian g = Splat(-0.3 + 0.0003 * i, -1, -0.5, 0.02, false);  // lies, of the side's colour
    g[kRefDc] = g[kRefDc + 1] = g[kRefDc + 2] = 0.1;
    splats.push_back(g);
  }
  EXPECT_TRUE(FindRotatingShape(SideScene(), FromReference(splats, 0))->side);
}

// Of a disc with a thousand Gaussians on its rim, a twentieth of all may lie below its end.
TEST(RotatingMask, ManyGaussiansBelowTheRimAreNoDisc) {
  const auto has_end = [](int below) {
    std::vector<ReferenceGaussian> splats;
    for (int i = 0; i < 1000; ++i)
      splats.push_back(Splat(std::cos(i), std::sin(i), -0.001 * (i % 5), 0.02, true));
    for (int i = 0; i < below; ++i) splats.push_back(Splat(0.3, 0, -0.1, 0.02, true));
    const TrainingScene scene = SideScene();
    return FindRotatingShape(scene, FromReference(splats, 0))->swept.low > scene.region->low;
  };
  EXPECT_TRUE(has_end(0));
  EXPECT_TRUE(has_end(50));   // of 1050: 4.8 %
  EXPECT_FALSE(has_end(56));  // of 1056: 5.3 %
}

TEST(RotatingMask, GroundOfTheDiscsColourIsNoSide) {
  const TrainingScene scene = SideScene();
  EXPECT_TRUE(FindRotatingShape(scene, FromReference(DiscWithStaticEnd(0.1, true), 0))->side);
  const std::optional<RotatingShape> shape =
      FindRotatingShape(scene, FromReference(DiscWithStaticEnd(0.1, false), 0));
  ASSERT_TRUE(shape);
  EXPECT_FALSE(shape->side);
  EXPECT_NEAR(shape->swept.low, kSideEnd, 1e-6);
}

TEST(RotatingMask, KeepsTheRegionWithoutARim) {
  std::vector<ReferenceGaussian> cone;  // its widest part is its top
  for (int i = 0; i < 2000; ++i) {
    const double z = -0.2 + 0.0001 * i;
    const double radius = 0.5 + 2.5 * (z + 0.2);
    cone.push_back(Splat(radius * std::cos(i), radius * std::sin(i), z, 0.02, true));
  }
  const TrainingScene scene = SideScene();
  const std::optional<RotatingShape> shape = FindRotatingShape(scene, FromReference(cone, 0));
  ASSERT_TRUE(shape);
  EXPECT_FALSE(shape->side);
  EXPECT_EQ(shape->swept.low, scene.region->low);
  EXPECT_EQ(shape->swept.radius, scene.region->radius);
}

TEST(RotatingMask, APlainSideGoesOnInItsColour) {
  // Colour of band 0 is 0.5 + 0.28 dc: 0.03 off the side's, and 0.28 off.
  const PixelMask same = MaskOf(DiscWithStaticEnd(0.1), SideScene());
  const PixelMask other = MaskOf(DiscWithStaticEnd(-1), SideScene());
  const int side = 30 + static_cast<int>(-150 * kSideEnd / 2);
  const int below = 30 + static_cast<int>(-150 * (kSideEnd - 0.02));
  EXPECT_TRUE(IsInside(same, 30, side));
  EXPECT_TRUE(IsInside(other, 30, side));
  EXPECT_TRUE(IsInside(same, 30, below));
  EXPECT_FALSE(IsInside(other, 30, below));
  EXPECT_FALSE(IsInside(same, 30, 50));
}

TEST(RotatingMask, DoesNotTrustDepthsOfASingleStation) {
  const int64_t area = Area(MaskOf(DiscOnGround(), TurntableScene(1)));
  std::vector<ReferenceGaussian> splats = DiscOnGround();
  AddShadow(1.5, &splats);
  EXPECT_EQ(Area(MaskOf(splats, TurntableScene(1))), area);
}

}  // namespace
}  // namespace s2gs
