#include "mesh/refine/offset_field.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <vector>

#include "tests/mesh/refine/sphere_photos.h"
#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

TEST(OffsetField, SolvesTheNormalEquations) {
  const TriangleMesh mesh = Sphere(1, 6);
  const VertexGraph graph(mesh);
  const auto n = static_cast<int>(graph.size());
  RandomNumbers random(5);
  std::vector<OffsetObservation> observations(n);
  Eigen::MatrixXd matrix = Eigen::MatrixXd::Zero(n, n);
  Eigen::VectorXd right = Eigen::VectorXd::Zero(n);
  const double smoothness = 0.4;
  const double prior = 0.02;
  for (int i = 0; i < n; ++i) {
    if (i % 3 == 0) {
      observations[i] = {static_cast<float>(random.Uniform(-2, 2)), static_cast<float>(random.Uniform(0, 3))};
    }
    matrix(i, i) += observations[i].weight + prior;
    right[i] = static_cast<double>(observations[i].weight) * observations[i].offset;
    for (const uint32_t j : graph.Neighbors(i)) {
      matrix(i, i) += smoothness;
      matrix(i, static_cast<int>(j)) -= smoothness;
    }
  }
  const Eigen::VectorXd expected = matrix.ldlt().solve(right);
  const std::vector<float> offsets = SmoothOffsets(graph, observations, smoothness, prior, 2);
  // The iterations stop at a residual of 1e-4.
  for (int i = 0; i < n; ++i) EXPECT_NEAR(offsets[i], expected[i], 1e-3);
}

TEST(OffsetField, AveragesKnownRowsAlone) {
  TriangleMesh mesh;
  mesh.vertices.resize(5, Eigen::Vector3f::Zero());
  mesh.triangles.emplace_back(0, 1, 2);
  mesh.triangles.emplace_back(2, 1, 3);
  std::vector<float> rows = {1, 10, 2, 20, 3, 30, 100, 100, 7, 70};
  AverageOverNeighbors(VertexGraph(mesh), {1, 1, 1, 0, 1}, 2, 1, 2, &rows);
  EXPECT_EQ(rows, (std::vector<float>{2, 20, 2, 20, 2, 20, 100, 100, 7, 70}));
}

}  // namespace
}  // namespace s2gs
