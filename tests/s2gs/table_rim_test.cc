#include "s2gs/table_rim.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>
#include <optional>
#include <vector>

#include "s2gs/core/rng.h"
#include "s2gs/rotating_mask.h"
#include "sfm_split/base/angles.h"
#include "tests/s2gs/backend/reference_render.h"
#include "tests/support/random_numbers.h"
#include "tests/support/view_from_above.h"

namespace s2gs {
namespace {

constexpr double kStep = 0.01;
constexpr double kRim = 1;
constexpr double kMinShare = 0.5;

// \param is_inside  by direction [radians] and distance. \param drop  of the height beyond. \param change  of
// the colour beyond.
LevelSurface SurfaceOf(const std::function<bool(double, double)>& is_inside, float drop, float change) {
  LevelSurface surface{36, 120, kStep, 0, 0.005, {}, {}};
  for (int d = 0; d < surface.num_directions; ++d) {
    for (int s = 0; s < surface.num_steps; ++s) {
      const bool inside = is_inside(2 * kPi * d / surface.num_directions, (s + 0.5) * kStep);
      surface.heights.push_back(inside ? 0 : -drop);
      const Random4 bits = RandomBits(1, static_cast<uint64_t>(d), static_cast<uint64_t>(s));
      for (int c = 0; c < 3; ++c) {
        const float noise = 0.02F * (UnitFloat(bits.words[c]) - 0.5F);
        surface.colors.push_back(0.5F + noise + (inside ? 0 : change));
      }
    }
  }
  return surface;
}

bool IsInCircle(double /*direction*/, double distance) { return distance < kRim; }
bool IsInSquare(double direction, double distance) {
  return distance * std::max(std::abs(std::cos(direction)), std::abs(std::sin(direction))) < kRim;
}

TEST(CircularEdge, IsFoundByHeightAndByColour) {
  for (const auto& [drop, change] : {std::pair(0.1F, 0.0F), std::pair(0.0F, 0.2F)}) {
    const std::optional<CircularEdge> edge = FindCircularEdge(SurfaceOf(IsInCircle, drop, change), kMinShare);
    ASSERT_TRUE(edge);
    EXPECT_NEAR(edge->distance, kRim, kStep / 2);
    EXPECT_EQ(edge->share, 1);
  }
}

TEST(CircularEdge, IsFoundWhereAThirdOfItIsHidden) {
  LevelSurface surface = SurfaceOf(IsInCircle, 0.1F, 0);
  for (size_t i = 0; i < surface.heights.size() / 3; ++i) {
    surface.heights[i] = std::numeric_limits<float>::quiet_NaN();
  }
  const std::optional<CircularEdge> edge = FindCircularEdge(surface, kMinShare);
  ASSERT_TRUE(edge);
  EXPECT_NEAR(edge->distance, kRim, kStep / 2);
}

TEST(CircularEdge, NoneInASquareOrAnEvenSurface) {
  EXPECT_FALSE(FindCircularEdge(SurfaceOf(IsInSquare, 0.1F, 0), kMinShare));
  EXPECT_FALSE(FindCircularEdge(SurfaceOf(IsInSquare, 0, 0.2F), kMinShare));
  EXPECT_FALSE(FindCircularEdge(SurfaceOf([](double, double) { return true; }, 0, 0), kMinShare));
}

// At least so many successes of so many trials.
double UpperTail(int successes, int trials, double chance) {
  double sum = 0;
  for (int k = successes; k <= trials; ++k) {
    sum += std::exp(std::lgamma(trials + 1.0) - std::lgamma(k + 1.0) - std::lgamma(trials - k + 1.0) +
                    k * std::log(chance) + (trials - k) * std::log1p(-chance));
  }
  return sum;
}

// An even surface that ends in some of the 36 directions after 100 of 120 steps, by its height or its colour.
TEST(CircularEdge, ItsShareAndChanceAreThoseOfItsCounts) {
  for (const int num_ending : {36, 30, 12}) {
    for (const bool by_height : {true, false}) {
      LevelSurface surface{36, 120, kStep, 2, 0.005, {}, {}};
      for (int d = 0; d < 36; ++d) {
        for (int s = 0; s < 120; ++s) {
          const bool is_beyond = s >= 100 && d % 36 < num_ending;
          surface.heights.push_back(is_beyond && by_height ? 1.9F : 2.004F);
          for (int c = 0; c < 3; ++c)
            surface.colors.push_back(is_beyond && !by_height && c == 1 ? 0.7F : 0.3F);
        }
      }
      // An edge is looked at two steps before and behind it, so that four rings have it. Rings that the
      // surface reaches in most directions are counted: those from the third on to the third before the last,
      // or to where too few are left.
      const int num_rings = by_height && num_ending > 18 ? 100 : 116;
      int on = 0;
      for (int s = 2; s < 2 + num_rings; ++s) on += by_height && s >= 102 ? 36 - num_ending : 36;
      const double chance = 4.0 * num_ending / on;
      const double expected = num_rings * UpperTail(num_ending, 36, chance);
      ASSERT_LT(expected, 1e-3);
      const double share = num_ending / 36.0;
      const std::optional<CircularEdge> edge = FindCircularEdge(surface, share);
      ASSERT_TRUE(edge) << num_ending << by_height;
      EXPECT_NEAR(edge->distance, 100 * kStep, 1e-9);
      EXPECT_DOUBLE_EQ(edge->share, share);
      EXPECT_NEAR(std::log(edge->false_alarms), std::log(expected), 1e-6);
      EXPECT_FALSE(FindCircularEdge(surface, share + 0.001));
    }
  }
}

TEST(CircularEdge, NoneAboutAnotherAxis) {
  const auto is_inside = [](double direction, double distance) {
    return std::hypot(distance * std::cos(direction) - 0.4, distance * std::sin(direction)) < kRim;
  };
  EXPECT_FALSE(FindCircularEdge(SurfaceOf(is_inside, 0.1F, 0), kMinShare));
}

constexpr double kTableRadius = 1;
constexpr double kSideEnd = -0.2;
constexpr double kGround = -0.4;
constexpr int kSize = 100;      // [px] of a photo
constexpr double kFocal = 100;  // [px]
constexpr double kDistance = 4;

// Faces upwards, or away from the axis.
ReferenceGaussian Splat(const Eigen::Vector3d& x, bool faces_up, double scale, double dc, bool rotates) {
  ReferenceGaussian g{};
  for (int i = 0; i < 3; ++i) {
    g[kRefCentre + i] = x[i];
    g[kRefDc + i] = dc;
  }
  g[kRefLogScale] = g[kRefLogScale + 1] = std::log(scale);
  const Eigen::Vector3d normal =
      faces_up ? Eigen::Vector3d::UnitZ() : Eigen::Vector3d(x.x(), x.y(), 0).normalized();
  const Eigen::Quaterniond q = Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), normal);
  g[kRefRotation] = q.w();
  g[kRefRotation + 1] = q.x();
  g[kRefRotation + 2] = q.y();
  g[kRefRotation + 3] = q.z();
  g[kRefOpacity] = 8;
  g[kRefForeground] = rotates ? 10 : -10;
  return g;
}

// A plain round table above the ground, and a small rotating thing on it.
std::vector<ReferenceGaussian> ThingOnTable(bool table_rotates) {
  std::vector<ReferenceGaussian> scene;
  constexpr double kApart = 0.05;
  for (int i = -40; i <= 40; ++i) {
    for (int j = -40; j <= 40; ++j) {
      const double x = i * kApart;
      const double y = j * kApart;
      scene.push_back(Splat({x, y, kGround}, true, kApart, -1, false));
      if (std::hypot(x, y) < kTableRadius)
        scene.push_back(Splat({x, y, 0}, true, kApart / 2, 0, table_rotates));
    }
  }
  for (int i = 0; i < 126; ++i) {
    const double x = kTableRadius * std::cos(i * kApart);
    const double y = kTableRadius * std::sin(i * kApart);
    for (double z = -0.025; z > kSideEnd; z -= kApart) {
      scene.push_back(Splat({x, y, z}, false, kApart / 2, 0, table_rotates));
    }
    for (double z = 0; z < 0.3; z += kApart)
      scene.push_back(Splat({x / 3, y / 3, z}, false, kApart / 2, 1, true));
  }
  return scene;
}

// Photos from 30 degrees above the table, the stations 120 degrees apart.
TrainingScene SceneOf(int num_stations) {
  TrainingScene scene;
  scene.mode = TrainMode::kS2gs;
  scene.axis = TurntableAxis();
  scene.region = RotatingRegion{TurntableAxis(), 0.5, -0.1, 0.5};
  for (int station = 0; station < num_stations; ++station) {
    ScenePhoto photo;
    photo.station = station;
    photo.view = ViewFromAbove(kSize, kSize, kFocal, 2 * kPi / 3 * station, kDistance);
    scene.photos.push_back(photo);
  }
  return scene;
}

std::unique_ptr<Backend> BackendOf(const std::vector<ReferenceGaussian>& splats) {
  std::unique_ptr<Backend> backend = MakeCpuBackend(1);
  TrainState state;
  state.gaussians = FromReference(splats, 0);
  backend->SetState(state);
  return backend;
}

TEST(TableRim, OfAPlainTableIsFoundAndUndecided) {
  const std::optional<TableRim> rim = FindTableRim(SceneOf(2), BackendOf(ThingOnTable(false)).get());
  ASSERT_TRUE(rim);
  // Splats of 0.025 stand out at edges by about their size.
  EXPECT_NEAR(rim->region.radius, kTableRadius, 0.03);
  EXPECT_NEAR(rim->region.low, kSideEnd, 0.04);
  EXPECT_GT(rim->region.high, 0);
  EXPECT_LT(rim->region.high, 0.1);
  EXPECT_EQ(rim->static_share, 1);
  EXPECT_TRUE(rim->IsUndecided());
}

// Of the top and of the side the larger share counts, by area: a fifth decides.
TEST(TableRim, TheStaticShareIsThatOfAreas) {
  for (const double share : {0.1, 0.3}) {
    std::vector<ReferenceGaussian> splats = ThingOnTable(true);
    double still = 0;
    for (ReferenceGaussian& splat : splats) {
      const bool is_top = splat[kRefCentre + 2] == 0 && splat[kRefDc] == 0 &&
                          std::hypot(splat[kRefCentre], splat[kRefCentre + 1]) < 0.99 * kTableRadius;
      if (!is_top) continue;
      still += share;
      if (still < 1) continue;
      still -= 1;
      splat[kRefForeground] = -10;
    }
    const std::optional<TableRim> rim = FindTableRim(SceneOf(2), BackendOf(splats).get());
    ASSERT_TRUE(rim);
    EXPECT_NEAR(rim->static_share, share, 0.01);
    EXPECT_EQ(rim->IsUndecided(), share > 0.2);
  }
}

// A rim is as likely by chance as heights are looked at. What gets less from one height to the next, as below
// the table here, where nobody sees it, is level at one height alone.
TEST(TableRim, IsLookedForWhereMoreIsLevelThanAboveAndBelow) {
  const std::optional<TableRim> one = FindTableRim(SceneOf(2), BackendOf(ThingOnTable(true)).get());
  std::vector<ReferenceGaussian> splats = ThingOnTable(true);
  for (int level = 1; level <= 48; ++level) {
    const double scale = 0.035 * std::exp(-0.02 * level);
    for (double x = -0.6; x < 0.6; x += 0.08) {
      for (double y = -0.6; y < 0.6; y += 0.08)
        splats.push_back(Splat({x, y, kGround + 0.0025 * level}, true, scale, -1, false));
    }
  }
  const std::optional<TableRim> other = FindTableRim(SceneOf(2), BackendOf(splats).get());
  ASSERT_TRUE(one && other);
  EXPECT_EQ(one->region.radius, other->region.radius);
  EXPECT_DOUBLE_EQ(other->false_alarms, one->false_alarms);
}

// The same scene in another unit, elsewhere and about another axis.
TEST(TableRim, ScalesWithTheScene) {
  const std::optional<TableRim> one = FindTableRim(SceneOf(3), BackendOf(ThingOnTable(false)).get());
  TrainingScene scene = SceneOf(3);
  constexpr double kScale = 0.5;
  const Rigid3 moved{Eigen::Quaterniond(Eigen::AngleAxisd(1.1, Eigen::Vector3d(1, 2, -1).normalized())),
                     {0.3, -0.2, 0.1}};
  std::vector<ReferenceGaussian> splats = ThingOnTable(false);
  for (ReferenceGaussian& g : splats) {
    const Eigen::Vector3d x =
        moved * (kScale * Eigen::Vector3d(g[kRefCentre], g[kRefCentre + 1], g[kRefCentre + 2]));
    const Eigen::Quaterniond q =
        moved.rotation *
        Eigen::Quaterniond(g[kRefRotation], g[kRefRotation + 1], g[kRefRotation + 2], g[kRefRotation + 3]);
    for (int i = 0; i < 3; ++i) g[kRefCentre + i] = x[i];
    g[kRefRotation] = q.w();
    for (int i = 0; i < 3; ++i) g[kRefRotation + 1 + i] = q.vec()[i];
    for (int i = 0; i < 2; ++i) g[kRefLogScale + i] += std::log(kScale);
  }
  scene.axis->point = moved.translation;
  scene.axis->direction = moved.rotation * Eigen::Vector3d::UnitZ();
  scene.region = RotatingRegion{*scene.axis, kScale * scene.region->radius, kScale * scene.region->low,
                                kScale * scene.region->high};
  for (ScenePhoto& photo : scene.photos) {
    Rigid3 pose = photo.view.cam_from_world;
    pose.translation *= kScale;
    photo.view.cam_from_world = photo.view.cam_from_object = pose * moved.Inverse();
  }
  const std::optional<TableRim> other = FindTableRim(scene, BackendOf(splats).get());
  ASSERT_TRUE(one && other);
  // Other directions, other pixels: a step of the nearer look is 1.2 radii / 120.
  EXPECT_NEAR(other->region.radius, kScale * one->region.radius, 0.012 * kScale);
  EXPECT_NEAR(other->region.low, kScale * one->region.low, 0.012 * kScale);
  EXPECT_NEAR(other->region.high, kScale * one->region.high, 0.005 * kScale);
  EXPECT_EQ(other->static_share, 1);
  EXPECT_GT(other->share, 0.8);  // .89: some directions look between the splats of the rim
  EXPECT_LT(other->false_alarms, 1e-6);
}

TEST(TableRim, IsTheSameOnTheGpu) {
  std::unique_ptr<Backend> gpu;
  try {
    gpu = MakeCudaBackend(0);
  } catch (const UserError& error) {
    GTEST_SKIP() << "no GPU, so the rim was not looked for there: " << error.what();
  }
  TrainState state;
  state.gaussians = FromReference(ThingOnTable(false), 0);
  gpu->SetState(state);
  const std::optional<TableRim> on_gpu = FindTableRim(SceneOf(3), gpu.get());
  const std::optional<TableRim> on_cpu = FindTableRim(SceneOf(3), BackendOf(ThingOnTable(false)).get());
  ASSERT_TRUE(on_gpu && on_cpu);
  // A step of the nearer look is 1.2 radii / 120; both draw the same up to the order of sums.
  EXPECT_NEAR(on_gpu->region.radius, on_cpu->region.radius, 0.003);
  EXPECT_NEAR(on_gpu->region.low, on_cpu->region.low, 0.003);
  EXPECT_NEAR(on_gpu->region.high, on_cpu->region.high, 0.003);
  EXPECT_EQ(on_gpu->static_share, on_cpu->static_share);
}

TEST(TableRim, OfATableThatTurnsIsDecided) {
  const std::optional<TableRim> rim = FindTableRim(SceneOf(2), BackendOf(ThingOnTable(true)).get());
  ASSERT_TRUE(rim);
  EXPECT_NEAR(rim->region.radius, kTableRadius, 0.03);
  EXPECT_EQ(rim->static_share, 0);
  EXPECT_FALSE(rim->IsUndecided());
}

// A rotating thing of no shape above the ground.
TEST(TableRim, NoneWithoutATable) {
  std::vector<ReferenceGaussian> scene;
  for (const ReferenceGaussian& g : ThingOnTable(false)) {
    if (g[kRefCentre + 2] == kGround) scene.push_back(g);
  }
  RandomNumbers random(3);
  for (int i = 0; i < 200; ++i) {
    scene.push_back(Splat({random.Uniform(-0.2, 0.5), random.Uniform(-0.4, 0.1), random.Uniform(0, 0.4)},
                          i % 2 == 0, 0.03, 1, true));
  }
  EXPECT_FALSE(FindTableRim(SceneOf(2), BackendOf(scene).get()));
}

TEST(TableRim, IsNotLookedForFromOneStation) {
  EXPECT_FALSE(FindTableRim(SceneOf(1), BackendOf(ThingOnTable(false)).get()));
}

TEST(TableRim, MakesMasksHaveTheTable) {
  const TrainingScene scene = SceneOf(2);
  const std::unique_ptr<Backend> backend = BackendOf(ThingOnTable(false));
  std::optional<RotatingShape> shape = FindRotatingShape(scene, backend->GetGaussians());
  ASSERT_TRUE(shape);
  const auto mask = [&] {
    return RotatingMask(backend->Render(MaskRequest(scene, shape, scene.photos[0].view)));
  };
  // Where a place shows in the first photo.
  const auto at = [&](double x, double y, double z) {
    const Eigen::Vector3d in_camera = scene.photos[0].view.cam_from_world * Eigen::Vector3d(x, y, z);
    const auto column = static_cast<size_t>(kSize / 2.0 + kFocal * in_camera.x() / in_camera.z());
    const auto row = static_cast<size_t>(kSize / 2.0 + kFocal * in_camera.y() / in_camera.z());
    return row * kSize + column;
  };
  EXPECT_EQ(mask().inside[at(0.8, 0, 0)], 0);
  const std::optional<TableRim> rim = FindTableRim(scene, backend.get());
  ASSERT_TRUE(rim);
  CountTableAsRotating(*rim, &*shape);
  const PixelMask with_table = mask();
  EXPECT_EQ(with_table.inside[at(0.8, 0, 0)], 1);
  EXPECT_EQ(with_table.inside[at(0, 0.8, 0)], 1);
  EXPECT_EQ(with_table.inside[at(1, 0, -0.1)], 1);
  EXPECT_EQ(with_table.inside[at(0.3, 0, 0.2)], 1);
  EXPECT_EQ(with_table.inside[at(1.3, 0, kGround)], 0);
  EXPECT_EQ(with_table.inside[at(0, 1.3, kGround)], 0);
}

}  // namespace
}  // namespace s2gs
