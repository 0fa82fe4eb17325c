#include "mesh/refine/surface_relief.h"

#include <gtest/gtest.h>

#include <cmath>
#include <utility>
#include <vector>

#include "tests/mesh/refine/sphere_photos.h"

namespace s2gs {
namespace {

TEST(SurfaceRelief, HeightsAreTheSpheres) {
  const TriangleMesh mesh = Sphere(1, 200);
  const SurfaceRelief relief(mesh);
  SurfaceRelief::Scratch scratch;
  // A radius of 10 spacings, three of the mesh's edges each.
  for (const uint32_t vertex : {20000U, 30000U, 55555U}) {
    SurfacePatch patch;
    patch.middle = mesh.vertices[vertex];
    patch.normal = patch.middle.normalized();
    patch.u = patch.normal.unitOrthogonal();
    patch.v = patch.normal.cross(patch.u);
    patch.spacing = 0.1F;
    relief.Lay(vertex, &scratch, &patch);
    ASSERT_EQ(patch.num_points, kPatchSize);
    for (const Eigen::Vector3f& point : patch.points) {
      const float beside = point.head<2>().squaredNorm();
      // The facets' sag is 1e-3 spacings.
      EXPECT_NEAR(point.z(), std::sqrt(100 - beside) - 10, 1e-3);
    }
  }
}

// A ridge along y: level on the left, falling at 45 degrees on the right, with a wall below.
TEST(SurfaceRelief, LeavesOutWhatFacesAway) {
  TriangleMesh mesh;
  for (const float y : {-9.0F, 9.0F}) {
    for (const auto& [x, z] :
         std::vector<std::pair<float, float>>{{-9, 0}, {0.5F, 0}, {1.5F, -1}, {1.5F, -9}}) {
      mesh.vertices.emplace_back(x, y, z);
    }
  }
  for (uint32_t i = 0; i < 3; ++i) {
    mesh.triangles.emplace_back(i, i + 1, i + 4);
    mesh.triangles.emplace_back(i + 1, i + 5, i + 4);
  }
  const SurfaceRelief relief(mesh);
  SurfaceRelief::Scratch scratch;
  SurfacePatch patch;
  patch.middle = {0, 0, 0};
  relief.Lay(1, &scratch, &patch);
  // Four of the five columns: the wall stands before the last.
  ASSERT_EQ(patch.num_points, 20);
  for (const Eigen::Vector3f& point : patch.points) {
    if (&point == &patch.points[20]) break;
    EXPECT_NEAR(point.z(), point.x() > 0.5F ? 0.5F - point.x() : 0.0F, 1e-5F);
  }
  // A camera on the left that the slope on the right faces away from.
  ObjectView view = {8, 8, 600, 600, 4, 4, Rigid3()};
  view.cam_from_object.translation = {10, 0, -5};
  const PhotoPyramid photo(view, {8, 8, 1, std::vector<uint8_t>(64)});
  patch.views[0] = &photo;
  patch.num_views = 1;
  relief.Lay(1, &scratch, &patch);
  EXPECT_EQ(patch.num_points, 15);
}

// More vertices than are looked at lie in the patch: it is the part of the plane that was reached, or flat.
TEST(SurfaceRelief, EndsOnADenseMesh) {
  constexpr int kDense = 160;
  TriangleMesh mesh;
  for (int y = 0; y < kDense; ++y) {
    for (int x = 0; x < kDense; ++x)
      mesh.vertices.emplace_back(0.02F * static_cast<float>(x - kDense / 2),
                                 0.02F * static_cast<float>(y - kDense / 2), 0);
  }
  for (uint32_t y = 0; y + 1 < kDense; ++y) {
    for (uint32_t x = 0; x + 1 < kDense; ++x) {
      const uint32_t at = y * kDense + x;
      mesh.triangles.emplace_back(at, at + 1, at + kDense);
      mesh.triangles.emplace_back(at + 1, at + kDense + 1, at + kDense);
    }
  }
  const SurfaceRelief relief(mesh);
  SurfaceRelief::Scratch scratch;
  SurfacePatch patch;
  patch.middle = {0, 0, 0};
  relief.Lay(kDense / 2 * kDense + kDense / 2, &scratch, &patch);
  for (int i = 0; i < patch.num_points; ++i) EXPECT_EQ(patch.points[static_cast<size_t>(i)].z(), 0);
}

}  // namespace
}  // namespace s2gs
