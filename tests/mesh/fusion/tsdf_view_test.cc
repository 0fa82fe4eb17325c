#include "mesh/fusion/tsdf_view.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <set>
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

// A wall that leans and has holes, a mask of another size about a part of it, and colours of a third size.
DepthView LeaningWall(const Eigen::Vector2d& first_position, bool with_normals) {
  DepthView view;
  view.camera = {kWidth, kHeight, 60, 55, 30, 25, Rigid3()};
  view.first_position = first_position;
  const Eigen::Vector3d normal = Eigen::Vector3d(0.5, -0.2, -0.8).normalized();
  const size_t count = static_cast<size_t>(kWidth) * kHeight;
  view.depths.assign(count, 0);
  if (with_normals) view.normals.assign(3 * count, 0);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const size_t i = static_cast<size_t>(y) * kWidth + x;
      const Eigen::Vector3d ray((x + first_position.x() - 30) / 60, (y + first_position.y() - 25) / 55, 1);
      view.depths[i] = static_cast<float>(-2 / normal.dot(ray));
      if (x % 9 == 4 && y % 7 == 3) view.depths[i] = 0;
      for (int c = 0; with_normals && c < 3; ++c) view.normals[c * count + i] = static_cast<float>(normal[c]);
    }
  }
  view.mask = {40, 30, 1, {}};
  for (int y = 0; y < 30; ++y) {
    for (int x = 0; x < 40; ++x) {
      const double from_middle = std::hypot(x - 28, y - 20);
      view.mask.pixels.push_back(from_middle < 3 ? 255 : from_middle < 6 ? 150 : from_middle < 8 ? 127 : 0);
    }
  }
  view.colors = {96, 24, 3, {}};
  for (int i = 0; i < 96 * 24 * 3; ++i) view.colors.pixels.push_back(static_cast<uint8_t>(i * 37 % 251));
  return view;
}

// Pixel by pixel what the header says.
TEST(PrepareTsdfView, PixelsAreWhatDepthsMasksAndNormalsSay) {
  for (const Eigen::Vector2d& first : {Eigen::Vector2d(0.5, 0.5), Eigen::Vector2d(0, 0)}) {
    for (const bool carve : {true, false}) {
      const DepthView in = LeaningWall(first, true);
      TsdfOptions options;
      options.carve = carve;
      options.max_view_angle_deg = 60;
      const TsdfView view = PrepareTsdfView(in, options);
      const auto mask_at = [&](int x, int y) {
        return *in.mask.Pixel(std::min(39, static_cast<int>((x + first.x()) * 40 / kWidth)),
                              std::min(29, static_cast<int>((y + first.y()) * 30 / kHeight))) /
               255.0;
      };
      Eigen::AlignedBox2i used;
      for (int y = 0; y < kHeight; ++y) {
        for (int x = 0; x < kWidth; ++x) {
          if (mask_at(x, y) >= 0.5) used.extend(Eigen::Vector2i(x, y));
        }
      }
      const int margin = carve ? 40 : 0;
      EXPECT_EQ(view.map_x, std::max(0, used.min().x() - margin));
      EXPECT_EQ(view.map_y, std::max(0, used.min().y() - margin));
      EXPECT_EQ(view.map_x + view.map_width, std::min(kWidth, used.max().x() + margin + 1));
      EXPECT_EQ(view.map_y + view.map_height, std::min(kHeight, used.max().y() + margin + 1));
      ASSERT_EQ(view.planes.size(), kFirstPixel + static_cast<size_t>(view.map_width) * view.map_height);
      ASSERT_EQ(view.colors.size() + kFirstPixel, view.planes.size());
      EXPECT_EQ(view.planes[kOutsideMap].weight, carve ? -40 : 0);
      int64_t num_depths = 0;
      std::vector<double> depths;
      for (int row = 0; row < view.map_height; ++row) {
        for (int column = 0; column < view.map_width; ++column) {
          const int x = view.map_x + column;
          const int y = view.map_y + row;
          const size_t at = static_cast<size_t>(row) * view.map_width + column;
          const PixelPlane& plane = view.planes[kFirstPixel + at];
          const uint8_t* rgb =
              in.colors.Pixel(std::min(95, static_cast<int>((x + first.x()) * 96 / kWidth)),
                              std::min(23, static_cast<int>((y + first.y()) * 24 / kHeight)));
          EXPECT_EQ(view.colors[at], rgb[0] + 256U * rgb[1] + 65536U * rgb[2]);
          if (mask_at(x, y) < 0.5) {
            double nearest = 1e9;
            for (int v = 0; v < kHeight; ++v) {
              for (int u = 0; u < kWidth; ++u) {
                if (mask_at(u, v) >= 0.5) nearest = std::min<double>(nearest, std::hypot(u - x, v - y));
              }
            }
            EXPECT_NEAR(plane.weight, carve ? -nearest : 0, 1e-4);
            continue;
          }
          const double depth = in.depths[static_cast<size_t>(y) * kWidth + x];
          if (depth == 0) {
            EXPECT_EQ(plane.weight, 0);
            continue;
          }
          const Eigen::Vector3d ray = view.Ray(column, row);
          EXPECT_NEAR(ray.x(), (x + first.x() - 30) / 60, 1e-12);
          EXPECT_NEAR(ray.y(), (y + first.y() - 25) / 55, 1e-12);
          EXPECT_NEAR(plane.a * ray.x() + plane.b * ray.y() + plane.c, 1 / depth, 1e-5);
          const Eigen::Vector3d normal = Eigen::Vector3d(0.5, -0.2, -0.8).normalized();
          EXPECT_LT((Eigen::Vector3d(plane.a, plane.b, plane.c).normalized() + normal).norm(), 1e-5);
          const double cosine = -normal.dot(ray.normalized());
          const double weight = cosine >= 0.5 ? mask_at(x, y) * cosine / (depth * depth) : 0;
          EXPECT_NEAR(plane.weight, weight, 1e-5) << x << " " << y;
          if (weight == 0) continue;
          if (num_depths++ % 16 == 0) depths.push_back(depth);
        }
      }
      EXPECT_EQ(view.num_depths, num_depths);
      EXPECT_GT(num_depths, 100);
      std::sort(depths.begin(), depths.end());
      EXPECT_NEAR(view.median_depth, depths[depths.size() / 2], 1e-6);
    }
  }
}

// Normals of no length, of another length, or that face away are none: the depths' own slope counts.
TEST(PrepareTsdfView, NormalsThatAreNoneLeaveTheDepths) {
  const DepthView without = LeaningWall({0.5, 0.5}, false);
  const TsdfView expected = PrepareTsdfView(without, TsdfOptions());
  for (const float factor : {0.0F, 0.4F, 2.1F, -1.0F}) {
    DepthView wrong = LeaningWall({0.5, 0.5}, true);
    for (float& value : wrong.normals) value *= factor;
    const TsdfView view = PrepareTsdfView(wrong, TsdfOptions());
    ASSERT_EQ(view.planes.size(), expected.planes.size());
    for (size_t i = 0; i < view.planes.size(); ++i) {
      EXPECT_EQ(view.planes[i].weight, expected.planes[i].weight);
      EXPECT_EQ(view.planes[i].a, expected.planes[i].a);
    }
  }
}

TEST(ViewParams, AreThoseOfTheVoxels) {
  DepthView in = LeaningWall({0, 0}, true);
  in.camera.cam_from_object = {
      Eigen::Quaterniond(Eigen::AngleAxisd(0.4, Eigen::Vector3d(1, -2, 0.5).normalized())), {0.1, 0.2, 3}};
  const TsdfView view = PrepareTsdfView(in, TsdfOptions());
  const Eigen::Vector3d origin(0.3, -0.1, 0.2);
  const TsdfViewParams params = ViewParams(view, origin, 0.02);
  const Eigen::Vector3d voxel(3, 5, -2);
  const Eigen::Vector3d in_camera = in.camera.cam_from_object * (origin + 0.02 * voxel);
  for (int i = 0; i < 3; ++i) {
    double x = params.translation[i];
    for (int j = 0; j < 3; ++j) x += params.rotation[3 * i + j] * voxel[j];
    EXPECT_NEAR(x, in_camera[i], 1e-6);
  }
  EXPECT_EQ(params.fx, 60);
  EXPECT_EQ(params.fy, 55);
  EXPECT_EQ(params.focal, 60);
  // A map whose first value is that of the corner begins half a pixel before the picture.
  EXPECT_EQ(params.cx, 30.5F);
  EXPECT_EQ(params.cy, 25.5F);
  EXPECT_EQ(params.width, kWidth);
  EXPECT_EQ(params.height, kHeight);
  EXPECT_EQ(params.map_x, view.map_x);
  EXPECT_EQ(params.map_y, view.map_y);
  EXPECT_EQ(params.map_width, view.map_width);
  EXPECT_EQ(params.map_height, view.map_height);
}

TEST(SampleTsdfSurface, TakesEveryNthPixelThatCounts) {
  DepthView in = LeaningWall({0.5, 0.5}, true);
  in.camera.cam_from_object.translation = {0.1, 0.2, 3};
  const TsdfView view = PrepareTsdfView(in, TsdfOptions());
  for (const int most : {1, 7, 50, 1000000}) {
    const std::vector<TsdfSurfaceSample> samples = SampleTsdfSurface(view, most);
    const int64_t stride = (view.num_depths + most - 1) / most;
    ASSERT_EQ(static_cast<int64_t>(samples.size()), (view.num_depths + stride - 1) / stride);
    size_t next = 0;
    int64_t count = 0;
    for (int row = 0; row < view.map_height; ++row) {
      for (int column = 0; column < view.map_width; ++column) {
        if (!(view.planes[kFirstPixel + static_cast<size_t>(row) * view.map_width + column].weight > 0))
          continue;
        if (count++ % stride != 0) continue;
        const double depth = in.depths[static_cast<size_t>(view.map_y + row) * kWidth + view.map_x + column];
        const Eigen::Vector3d x = depth * view.Ray(column, row) - Eigen::Vector3d(0.1, 0.2, 3);
        EXPECT_LT((samples[next].x_in_object - x).norm(), 1e-5);
        EXPECT_NEAR(samples[next].depth, depth, 1e-5);
        EXPECT_NEAR(samples[next].pixel, depth / std::sqrt(60.0 * 55.0), 1e-6);
        ++next;
      }
    }
  }
}

// Blocks are those that the band about the surface meets along the rays, whether pixels are finer than voxels
// or coarser.
TEST(FindViewBlocks, AreThoseOfTheBandAboutTheSurface) {
  const Eigen::Vector3d normal = Eigen::Vector3d(0.5, -0.2, -0.8).normalized();
  DepthView in = LeaningWall({0.5, 0.5}, true);
  in.mask = {};
  for (const double voxel_size : {0.01, 0.04, 0.1}) {
    TsdfBlockRequest request;
    request.origin = {-1.2, -1.1, 0.3};
    request.voxel_size = voxel_size;
    request.truncation_voxels = 3;
    request.region = Eigen::AlignedBox3d(Eigen::Vector3d(-9, -9, -9), Eigen::Vector3d(9, 9, 9));
    request.max_blocks = 10000000;
    int64_t outliers = 0;
    const TsdfView view = PrepareTsdfView(in, TsdfOptions());
    const std::vector<uint64_t> keys = FindViewBlocks(view, request, &outliers);
    EXPECT_EQ(outliers, 0);
    EXPECT_TRUE(std::is_sorted(keys.begin(), keys.end()));
    const std::set<uint64_t> found(keys.begin(), keys.end());
    EXPECT_EQ(found.size(), keys.size());
    // Voxels are centred about whole coordinates. The band's middle and its ends along the middle of each
    // pixel.
    const auto block_of = [&](const Eigen::Vector3d& x) {
      return TsdfBlockIndex::BlockKey(
          (((x - request.origin) / voxel_size + Eigen::Vector3d::Constant(0.5)) / 8)
              .array()
              .floor()
              .cast<int>()
              .matrix());
    };
    const int stride = std::max(
        1, static_cast<int>(std::lround(2 * voxel_size / (view.median_depth / std::sqrt(60.0 * 55.0)))));
    int seen = 0;
    for (int row = 0; row < view.map_height; row += stride) {
      for (int column = 0; column < view.map_width; column += stride) {
        if (!(view.planes[kFirstPixel + static_cast<size_t>(row) * view.map_width + column].weight > 0))
          continue;
        const Eigen::Vector3d ray = view.Ray(column, row);
        const Eigen::Vector3d middle = -2 / normal.dot(ray) * ray;
        ++seen;
        for (const double along : {-2.99, 0.0, 2.99}) {
          const uint64_t key = block_of(middle + along * voxel_size * ray.normalized());
          // With several rays a pixel none need go through its middle.
          if (stride > 1 || voxel_size > 0.03) EXPECT_EQ(found.count(key), 1U) << voxel_size << " " << along;
        }
      }
    }
    EXPECT_GT(seen, 20);
    // None lies farther away than the band reaches, and half a block's diagonal.
    for (const uint64_t key : keys) {
      const Eigen::Vector3d centre =
          request.origin +
          voxel_size * (8 * TsdfBlockIndex::BlockOfKey(key).cast<double>() + Eigen::Vector3d::Constant(3.5));
      EXPECT_LT(std::abs(normal.dot(centre) + 2), (3 + 4 * std::sqrt(3.0)) * voxel_size);
    }
    // They stop where there are too many.
    request.max_blocks = keys.size() / 4;
    const std::vector<uint64_t> few = FindViewBlocks(view, request, &outliers);
    EXPECT_GT(few.size(), request.max_blocks);
    EXPECT_LT(few.size(), keys.size());
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
