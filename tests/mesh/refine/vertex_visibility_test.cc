#include "mesh/refine/vertex_visibility.h"

#include <gtest/gtest.h>

#include <cmath>
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

}  // namespace
}  // namespace s2gs
