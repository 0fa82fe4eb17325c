#include "mesh/fusion/tsdf_view.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <vector>

#include "mesh/fusion/tsdf_cull.h"
#include "mesh/fusion/tsdf_voxel.h"
#include "tests/support/bad_input.h"

namespace s2gs {
namespace {

constexpr int kWidth = 64;
constexpr int kHeight = 48;

// A plane that faces the camera at a depth.
DepthView PlaneAt(float depth) {
  DepthView view;
  view.camera = {kWidth, kHeight, 60, 60, kWidth / 2.0, kHeight / 2.0, Rigid3()};
  view.depths.assign(static_cast<size_t>(kWidth) * kHeight, depth);
  return view;
}

TEST(PrepareTsdfView, RefusesPicturesWithoutPixels) {
  for (const bool is_height : {false, true}) {
    DepthView view = PlaneAt(2);
    (is_height ? view.camera.height : view.camera.width) = 0;
    view.depths.clear();
    ExpectUserError([&] { PrepareTsdfView(view, TsdfOptions()); }, {"no usable size"});
  }
}

// Pixels have their left and upper borders, pictures neither their right nor their lower one.
TEST(PlaneIndex, EndsAtThePicturesBorders) {
  const TsdfView view = PrepareTsdfView(PlaneAt(2), TsdfOptions());
  TsdfViewParams params = ViewParams(view, Eigen::Vector3d::Zero(), 1);
  params.fx = params.fy = 32;
  params.cx = params.cy = 16;
  params.width = 64;
  params.height = 48;
  // Cells (u, v) are 32 x + 16, 32 y + 16 at z = 1: exact in single precision.
  const auto index = [&](float u, float v) { return PlaneIndex(params, (u - 16) / 32, (v - 16) / 32, 1); };
  EXPECT_NE(index(0, 0), kOutsideImage);
  EXPECT_NE(index(63, 47), kOutsideImage);
  EXPECT_EQ(index(64, 10), kOutsideImage);
  EXPECT_EQ(index(10, 48), kOutsideImage);
  EXPECT_EQ(index(-0.5F, 10), kOutsideImage);
  EXPECT_EQ(index(10, -0.5F), kOutsideImage);
}

// A pixel far behind everything else: no blocks there, and it is counted.
TEST(FindViewBlocks, LeavesOutWhatLiesOutsideTheRegion) {
  DepthView with_far = PlaneAt(2);
  for (int y = 20; y < 24; ++y) {
    for (int x = 20; x < 24; ++x) with_far.depths[static_cast<size_t>(y) * kWidth + x] = 40;
  }
  TsdfBlockRequest request;
  request.origin = {-3, -3, 0};
  request.voxel_size = 0.02;
  request.truncation_voxels = 4;
  request.region = Eigen::AlignedBox3d(Eigen::Vector3d(-3, -3, 0.5), Eigen::Vector3d(3, 3, 3.5));
  request.max_blocks = 1000000;
  int64_t outliers = 0;
  const std::vector<uint64_t> blocks =
      FindViewBlocks(PrepareTsdfView(with_far, TsdfOptions()), request, &outliers);
  EXPECT_GT(outliers, 0);
  EXPECT_LE(outliers, 16);
  int64_t none = 0;
  const std::vector<uint64_t> without =
      FindViewBlocks(PrepareTsdfView(PlaneAt(2), TsdfOptions()), request, &none);
  EXPECT_EQ(none, 0);
  // The hole of 4 x 4 pixels alone may be missing.
  EXPECT_LE(blocks.size(), without.size());
  EXPECT_GT(blocks.size(), 0.9 * static_cast<double>(without.size()));
}

// Voxels count down to `behind` the plane: the smaller of the truncation and three voxels, and a few more.
TEST(MakeTsdfDepthTiles, ReachAsFarBehindAPlaneAsVoxelsCount) {
  const TsdfView view = PrepareTsdfView(PlaneAt(2), TsdfOptions());
  for (const double voxel_size : {0.01, 0.1}) {
    for (const double truncation : {0.02, 1.0}) {
      const TsdfDepthTiles tiles = MakeTsdfDepthTiles(view, truncation, voxel_size);
      const double behind = std::min(truncation, 3 * voxel_size);
      for (const float far : tiles.far) {
        if (far == 0) continue;
        EXPECT_GE(far, 2 + behind);
        // Twice that, and eight pixels' slope.
        EXPECT_LE(far, 2 * (1 + 8 / 60.0) + 2.02 * behind);
      }
    }
  }
}

}  // namespace
}  // namespace s2gs
