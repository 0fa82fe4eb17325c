#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <string>

#include "mesh/fusion/tsdf.h"
#include "mesh/surface/mesh_cleanup.h"

namespace s2gs {
namespace {

// The field that is refused; "" when none is.
template <typename Options, typename Change>
std::string Refused(Change change) {
  Options options;
  change(options);
  const OptionCheck check = options.Check();
  return check ? check->field : "";
}

TEST(MeshCleanupOptions, CheckNamesTheFault) {
  const auto refused = [](auto change) { return Refused<MeshCleanupOptions>(change); };
  EXPECT_EQ(refused([](auto&) {}), "");
  for (const double good : {0.0, 100.0}) {
    EXPECT_EQ(refused([&](auto& o) { o.min_cluster_area_pct = good; }), "");
  }
  for (const double wrong : {-1e-9, 100.1, std::nan("")}) {
    EXPECT_EQ(refused([&](auto& o) { o.min_cluster_area_pct = wrong; }), "min_cluster_area_pct");
  }
  for (const int good : {0, 500}) EXPECT_EQ(refused([&](auto& o) { o.max_hole_edges = good; }), "");
  for (const int wrong : {-1, 501}) {
    EXPECT_EQ(refused([&](auto& o) { o.max_hole_edges = wrong; }), "max_hole_edges");
  }
  for (const int good : {0, 1000}) EXPECT_EQ(refused([&](auto& o) { o.smoothing_iterations = good; }), "");
  for (const int wrong : {-1, 1001}) {
    EXPECT_EQ(refused([&](auto& o) { o.smoothing_iterations = wrong; }), "smoothing_iterations");
  }
  EXPECT_EQ(refused([](auto& o) { o.max_triangles = 0; }), "");
  EXPECT_EQ(refused([](auto& o) { o.max_triangles = -1; }), "max_triangles");
}

TEST(TsdfOptions, CheckNamesTheFault) {
  const auto refused = [](auto change) { return Refused<TsdfOptions>(change); };
  EXPECT_EQ(refused([](auto&) {}), "");
  for (const double wrong : {-1e-9, std::numeric_limits<double>::infinity(), std::nan("")}) {
    EXPECT_EQ(refused([&](auto& o) { o.voxel_size = wrong; }), "voxel_size");
  }
  EXPECT_EQ(refused([](auto& o) { o.voxel_size_pixels = 100; }), "");
  for (const double wrong : {0.0, 100.1, std::nan("")}) {
    EXPECT_EQ(refused([&](auto& o) { o.voxel_size_pixels = wrong; }), "voxel_size_pixels");
  }
  for (const int good : {8, 1'000'000}) EXPECT_EQ(refused([&](auto& o) { o.max_resolution = good; }), "");
  for (const int wrong : {7, 1'000'001}) {
    EXPECT_EQ(refused([&](auto& o) { o.max_resolution = wrong; }), "max_resolution");
  }
  for (const double good : {2.0, 32.0}) EXPECT_EQ(refused([&](auto& o) { o.truncation_voxels = good; }), "");
  for (const double wrong : {1.9, 32.1, std::nan("")}) {
    EXPECT_EQ(refused([&](auto& o) { o.truncation_voxels = wrong; }), "truncation_voxels");
  }
  for (const double wrong : {0.0, 89.5, std::nan("")}) {
    EXPECT_EQ(refused([&](auto& o) { o.max_view_angle_deg = wrong; }), "max_view_angle_deg");
  }
}

}  // namespace
}  // namespace s2gs
