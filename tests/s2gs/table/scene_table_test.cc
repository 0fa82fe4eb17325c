#include "s2gs/table/scene_table.h"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <memory>
#include <optional>
#include <vector>

#include "sfm_split/base/angles.h"
#include "tests/s2gs/backend/reference_render.h"
#include "tests/s2gs/table/table_on_ground.h"

namespace s2gs {
namespace {

constexpr int kLayers = 24;

// A level splat that rotates.
ReferenceGaussian SplatAt(const Eigen::Vector3d& x) {
  ReferenceGaussian g{};
  for (int k = 0; k < 3; ++k) g[kRefCentre + k] = x[k];
  g[kRefLogScale] = g[kRefLogScale + 1] = std::log(0.03);
  g[kRefRotation] = 1;
  g[kRefOpacity] = 8;
  g[kRefForeground] = 10;
  return g;
}

// Of a model: a ring of splats over the top, where photos see the table, and one on the axis so high that
// none does.
std::unique_ptr<Backend> ModelWithLayers(double radius, double height) {
  std::vector<ReferenceGaussian> splats = {SplatAt({0, 0, 0.9})};
  for (int i = 0; i < kLayers; ++i) {
    const double angle = 2 * kPi * i / kLayers;
    splats.push_back(SplatAt({radius * std::cos(angle), radius * std::sin(angle), kTableTop + height}));
  }
  std::unique_ptr<Backend> backend = MakeCpuBackend(1);
  TrainState state;
  state.gaussians = FromReference(splats, 0);
  backend->SetState(state);
  return backend;
}

SceneTable FindIn(const TrainingScene& scene, const SceneTableOptions& options,
                  std::optional<RotatingShape>* shape, Backend* backend) {
  Reporter silent;
  return SceneTable::Find(
      scene, [](const ScenePhoto& photo) { return photo.image; }, options, shape, backend, silent);
}

// The model's guess of a side that goes on below what turns, by its colour.
RotatingShape ShapeWithSide() {
  RotatingShape shape;
  shape.swept = TableRegion();
  shape.side.emplace();
  shape.side->region = {TurntableAxis(), 1.02, kTableBottom - 0.04, kTableBottom + 0.08};
  shape.side->color_tolerance = 0.1F;
  return shape;
}

TEST(SceneTable, WhereASideEndsPhotosSayAndNotTheModel) {
  const TrainingScene scene = TableOnGround(kTablePhotos, TopLook::kPlain);
  const std::unique_ptr<Backend> backend = ModelWithLayers(0.6, 0.1);
  std::optional<RotatingShape> shape = ShapeWithSide();
  const SceneTable table = FindIn(scene, {}, &shape, backend.get());
  ASSERT_TRUE(table.circle);
  ASSERT_TRUE(table.circle->side_end);
  EXPECT_FALSE(shape->side);
  EXPECT_EQ(shape->swept.low, kTableBottom);

  // Photos that show no table leave it.
  TrainingScene bare = scene;
  bare.region.reset();
  shape = ShapeWithSide();
  EXPECT_FALSE(FindIn(bare, {}, &shape, backend.get()).circle);
  EXPECT_TRUE(shape->side);
}

TEST(SceneTable, LayersAreTakenOutUnlessTheyAreToStay) {
  const TrainingScene scene = TableOnGround(kTablePhotos, TopLook::kPlain);
  SceneTableOptions options;
  options.cut_around = false;
  for (const bool is_cleared : {true, false}) {
    options.clear_plain_top = is_cleared;
    const std::unique_ptr<Backend> backend = ModelWithLayers(0.6, 0.1);
    std::optional<RotatingShape> shape;
    const SceneTable table = FindIn(scene, options, &shape, backend.get());
    ASSERT_TRUE(table.circle);
    EXPECT_EQ(backend->Count(), is_cleared ? 1 : 1 + kLayers);
    EXPECT_EQ(table.num_over_top, is_cleared ? kLayers : 0U);
  }
}

// The card on the top has other colours than it, and texture.
TEST(SceneTable, LayersAreTakenOutWherePhotosShowTexture) {
  const TrainingScene scene = TableOnGround(kTablePhotos, TopLook::kPlain);
  const std::unique_ptr<Backend> backend = ModelWithLayers(0.1, 1.5 * kTablePixel);
  const TrainState state = backend->GetState();
  std::optional<RotatingShape> shape;
  SceneTableOptions options;
  options.cut_around = false;
  const SceneTable table = FindIn(scene, options, &shape, backend.get());
  ASSERT_TRUE(table.circle);
  const std::vector<StationPhotos> stations = LoadStations(scene);
  const std::optional<TexturedTop> texture = TexturedTop::Learn(stations, table.rim->region);
  ASSERT_TRUE(texture);
  backend->SetState(state);
  const size_t seen_through =
      FindLayersOverTexture(*texture, stations, RotatingDepths(stations, backend.get()),
                            backend->GetPlacement())
          .size();
  EXPECT_GE(seen_through, 3U);  // of a card of a few tiles
  EXPECT_EQ(table.num_over_top, seen_through);
}

// Splats tell of a top that turns, but photos that agree on its texture all over the plane show its shape.
TEST(SceneTable, ATopThatPhotosShowToBeThePlaneIsDrawnAsOne) {
  for (const bool is_turning : {true, false}) {
    TrainingScene scene = TableOnGround(kTablePhotos, TopLook::kPlain);
    SpeckleTop(is_turning, &scene);
    ReferenceGaussian top = SplatAt({0, 0, kTableTop});
    ReferenceGaussian bottom = SplatAt({0, 0, kTableBottom});  // below the side's pixels
    for (ReferenceGaussian* wide : {&top, &bottom}) (*wide)[kRefLogScale] = (*wide)[kRefLogScale + 1] = 0;
    const std::unique_ptr<Backend> backend = MakeCpuBackend(1);
    TrainState state;
    state.gaussians = FromReference({top, bottom, SplatAt({0, 0, 0.9})}, 0);
    backend->SetState(state);
    std::optional<RotatingShape> shape;
    const SceneTable table = FindIn(scene, {}, &shape, backend.get());
    ASSERT_TRUE(table.circle);
    ASSERT_FALSE(table.rim->IsUndecided());
    ASSERT_GE(*table.textured_share, 0.5);
    EXPECT_EQ(table.is_plane, is_turning);
    EXPECT_EQ(backend->Count(), is_turning ? 1 : 3);
    const PinholeView& view = scene.photos.front().view;
    const size_t count = static_cast<size_t>(view.width) * view.height;
    RenderedView drawn;
    drawn.width = view.width;
    drawn.height = view.height;
    drawn.alpha.assign(count, 0);
    drawn.median_depth.assign(count, 0);
    drawn.expected_depth.assign(count, 0);
    drawn.normal.assign(3 * count, 0);
    table.DrawIntoMaps(view, &drawn);
    const auto is_drawn = [](float alpha) { return alpha == 1; };
    EXPECT_EQ(std::any_of(drawn.alpha.begin(), drawn.alpha.end(), is_drawn), is_turning);
  }
}

}  // namespace
}  // namespace s2gs
