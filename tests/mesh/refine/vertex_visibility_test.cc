#include "mesh/refine/vertex_visibility.h"

#include <gtest/gtest.h>

#include <cmath>
#include <utility>
#include <vector>

#include "mesh/surface/vertex_normals.h"
#include "tests/mesh/refine/sphere_photos.h"

namespace s2gs {
namespace {

TEST(VertexVisibility, DepthIsTheSpheres) {
  const TriangleMesh mesh = Sphere(1, 200);
  const ObjectView view = LookAtMiddle(0.4, 0.3);
  const std::vector<float> depths = RenderMeshDepth(mesh, view);
  const Eigen::Vector3d center = view.cam_from_object.translation;  // the sphere's, in the camera's frame
  int num_compared = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const Eigen::Vector3d ray((x + 0.5 - view.cx) / view.fx, (y + 0.5 - view.cy) / view.fy, 1);
      const double b = ray.dot(center) / ray.squaredNorm();
      const double root = b * b - (center.squaredNorm() - 1) / ray.squaredNorm();
      const float depth = depths[static_cast<size_t>(y) * kSide + x];
      if (root < 0) {
        EXPECT_FALSE(std::isfinite(depth));
      }
      if (root < 0.01) continue;  // at the outline a facet's sag counts many times
      // The facets' sag is 1e-4.
      ASSERT_NEAR(depth, b - std::sqrt(root), 1e-3) << x << ' ' << y;
      ++num_compared;
    }
  }
  EXPECT_GT(num_compared, 30000);
}

TEST(VertexVisibility, FrontIsSeenAndBackIsNot) {
  TriangleMesh mesh = Sphere(1, 100);
  ComputeNormals(&mesh);
  const ObjectView view = LookAtMiddle(0.4, 0.3);
  const VertexFlags seen = FindVisibleVertices(mesh, view, {0.2F, 0});
  const VertexFlags inner = FindVisibleVertices(mesh, view, {0.5F, 2});
  const Eigen::Matrix3d rotation = view.cam_from_object.rotation.toRotationMatrix();
  const Eigen::Vector3d camera = -(rotation.transpose() * view.cam_from_object.translation);
  for (size_t i = 0; i < mesh.vertices.size(); ++i) {
    const Eigen::Vector3d x = mesh.vertices[i].cast<double>();
    const double cosine = x.dot((camera - x).normalized());
    if (std::abs(cosine - 0.2) > 0.01) {
      EXPECT_EQ(seen.Get(i), cosine > 0.2) << cosine;
    }
    if (std::abs(cosine - 0.5) > 0.01) {
      EXPECT_EQ(inner.Get(i), cosine > 0.5) << cosine;
    }
  }
}

// A sheet before another, across the line of sight. The one behind is hidden beyond two pixels at its depth,
// of pixels that are not square the narrower.
TEST(VertexVisibility, WhatLiesNarrowPixelsBehindIsHidden) {
  constexpr int kSize = 40;
  ObjectView view{kSize, kSize, 400, 100, kSize / 2.0, kSize / 2.0, {}};
  for (const bool turned : {false, true}) {
    if (turned) std::swap(view.fx, view.fy);
    for (const double pixels : {1.8, 2.2}) {
      const auto front = static_cast<float>(1 - pixels / 400);
      TriangleMesh mesh;
      for (const float depth : {front, 1.0F}) {
        const auto first = static_cast<int32_t>(mesh.vertices.size());
        for (const auto& [x, y] : {std::pair(-1, -1), std::pair(1, -1), std::pair(1, 1), std::pair(-1, 1)}) {
          const float half = depth < 1 ? 1.0F : 0.02F;
          mesh.vertices.emplace_back(half * x, half * y, depth);
          mesh.normals.emplace_back(0, 0, -1);
        }
        mesh.triangles.push_back({first, first + 1, first + 2});
        mesh.triangles.push_back({first, first + 2, first + 3});
      }
      const VertexFlags seen = FindVisibleVertices(mesh, view, {0.2F, 0});
      for (size_t i = 4; i < 8; ++i) EXPECT_EQ(seen.Get(i), pixels < 2) << pixels << ' ' << turned;
    }
  }
}

// With every third triangle left out and every fifth there twice, so that depths are equal: as two meshes
// show it, each drawn from its first triangle to its last.
TEST(VertexVisibility, TrianglesShownWithAndWithoutSomeAreThoseOfTwoMeshes) {
  TriangleMesh mesh = Sphere(1, 60);
  const size_t num = mesh.triangles.size();
  for (size_t i = 0; i < num; i += 5) mesh.triangles.push_back(mesh.triangles[i]);
  std::vector<bool> keep;
  TriangleMesh rest;
  rest.vertices = mesh.vertices;
  std::vector<int32_t> number_of;  // in the mesh, of a triangle of the rest
  for (size_t i = 0; i < mesh.triangles.size(); ++i) {
    keep.push_back(i % 3 != 0);
    if (!keep[i]) continue;
    rest.triangles.push_back(mesh.triangles[i]);
    number_of.push_back(static_cast<int32_t>(i));
  }
  const ObjectView view = LookAtMiddle(0.4, 0.3);
  std::vector<int32_t> of_all, of_rest;
  RenderMeshDepth(mesh, view, &of_all);
  RenderMeshDepth(rest, view, &of_rest);
  const ShownTriangles shown = FindShownTriangles(mesh, keep, view);
  EXPECT_EQ(shown.of_all, of_all);
  int num_twice = 0;
  for (size_t pixel = 0; pixel < of_rest.size(); ++pixel) {
    const int32_t there = of_rest[pixel] < 0 ? -1 : number_of[static_cast<size_t>(of_rest[pixel])];
    ASSERT_EQ(shown.of_kept[pixel], there) << pixel;
    num_twice += of_all[pixel] >= 0 && of_all[pixel] % 5 == 0 && of_all[pixel] % 3 == 0 ? 1 : 0;
  }
  EXPECT_GT(num_twice, 100);  // whose first was left out
}

}  // namespace
}  // namespace s2gs
