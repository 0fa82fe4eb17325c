#include "mesh/refine/normal_integration.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <vector>

#include "mesh/surface/vertex_normals.h"
#include "tests/mesh/refine/sphere_photos.h"
#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

TriangleMesh RoughSphere(double sigma) {
  TriangleMesh mesh = Sphere(1, 12);
  RandomNumbers random(9);
  for (Eigen::Vector3f& vertex : mesh.vertices) vertex *= static_cast<float>(1 + sigma * random.Normal());
  ComputeNormals(&mesh);
  return mesh;
}

// The sphere's own, which is what the vertices point along.
ToldNormals TrueNormals(const TriangleMesh& mesh, float sigma_rad, double spread_rad) {
  ToldNormals told;
  for (const Eigen::Vector3f& vertex : mesh.vertices) told.normals.push_back(vertex.normalized());
  told.sigma_rad.assign(told.normals.size(), sigma_rad);
  told.spread_rad = spread_rad;
  return told;
}

// The formula of the header, written out edge by edge and solved densely.
TEST(IntegrateNormals, SolvesTheNormalEquations) {
  const TriangleMesh mesh = RoughSphere(0.02);
  const VertexGraph graph(mesh);
  ToldNormals told = TrueNormals(mesh, 0.05F, 0.1);
  told.sigma_rad[7] = 0;  // is not told
  told.sigma_rad[20] = 0.2F;
  const auto n = static_cast<int>(graph.size());
  Eigen::MatrixXd matrix = Eigen::MatrixXd::Zero(n, n);
  Eigen::VectorXd right = Eigen::VectorXd::Zero(n);
  for (int i = 0; i < n; ++i) {
    double squares = 0;
    for (const uint32_t k : graph.Neighbors(i)) {
      const auto j = static_cast<int>(k);
      const Eigen::Vector3d edge = (mesh.vertices[j] - mesh.vertices[i]).cast<double>();
      squares += edge.squaredNorm() / static_cast<double>(graph.Neighbors(i).size());
      if (j < i || i == 7 || j == 7) continue;
      const Eigen::Vector3d a = told.normals[i].cast<double>();
      const Eigen::Vector3d b = told.normals[j].cast<double>();
      const Eigen::Vector3d normal = (a + b).normalized();
      const double variance =
          (std::pow(told.sigma_rad[i], 2) + std::pow(told.sigma_rad[j], 2)) / 2 + (a - b).squaredNorm() / 12;
      Eigen::VectorXd row = Eigen::VectorXd::Zero(n);
      row[j] = normal.dot(mesh.normals[j].cast<double>());
      row[i] = -normal.dot(mesh.normals[i].cast<double>());
      const double weight = 1 / (variance * edge.squaredNorm());
      matrix += weight * row * row.transpose();
      right -= weight * normal.dot(edge) * row;
    }
    matrix(i, i) += 1 / (3 * told.spread_rad * told.spread_rad * squares);
  }
  const Eigen::VectorXd expected = matrix.ldlt().solve(right);
  const std::vector<float> offsets = IntegrateNormals(graph, mesh, told, 2);
  // The iterations stop at a residual of 1e-4; offsets are .01 to .05. Measured: 2.7e-5.
  for (int i = 0; i < n; ++i) EXPECT_NEAR(offsets[i], expected[i], 1e-4) << i;
}

// What all vertices around have in common stays.
TEST(IntegrateNormals, TakesNoiseOffARoundSurface) {
  TriangleMesh mesh = Sphere(1, 60);
  RandomNumbers random(9);
  const double sigma = 0.004;
  for (Eigen::Vector3f& vertex : mesh.vertices) vertex *= static_cast<float>(1 + sigma * random.Normal());
  ComputeNormals(&mesh);
  const std::vector<float> offsets =
      IntegrateNormals(VertexGraph(mesh), mesh, TrueNormals(mesh, 0.01F, 0.1), 0);
  double before = 0;
  double after = 0;
  for (size_t i = 0; i < offsets.size(); ++i) {
    before += std::pow(mesh.vertices[i].norm() - 1, 2);
    after += std::pow((mesh.vertices[i] + offsets[i] * mesh.normals[i]).norm() - 1, 2);
  }
  EXPECT_LT(std::sqrt(after), 0.5 * std::sqrt(before)) << std::sqrt(after / before);
}

// A chord of a round surface is at right angles to the mean of its ends' normals.
TEST(IntegrateNormals, LeavesARoundSurfaceAlone) {
  const TriangleMesh mesh = Sphere(1, 30);
  TriangleMesh with_normals = mesh;
  ComputeNormals(&with_normals);
  const std::vector<float> offsets =
      IntegrateNormals(VertexGraph(mesh), with_normals, TrueNormals(mesh, 0.01F, 0.1), 0);
  // Rounding of floats.
  for (const float offset : offsets) EXPECT_LT(std::abs(offset), 1e-5);
  // And where no normal is told, or nothing is known of the mesh, nothing moves.
  EXPECT_EQ(IntegrateNormals(VertexGraph(mesh), with_normals, TrueNormals(mesh, 0, 0.1), 0),
            std::vector<float>(mesh.vertices.size(), 0));
  EXPECT_EQ(IntegrateNormals(VertexGraph(mesh), with_normals, TrueNormals(mesh, 0.1F, 0), 0),
            std::vector<float>(mesh.vertices.size(), 0));
}

TEST(LeanAsMesh, TakesOffWhatErrsAlikeAndKeepsWhatDoesNot) {
  TriangleMesh mesh = Sphere(1, 60);
  ComputeNormals(&mesh);
  const VertexGraph graph(mesh);
  ToldNormals told = TrueNormals(mesh, 0.1F, 0.1);
  const Eigen::AngleAxisf turn(0.2F, Eigen::Vector3f::UnitX());
  for (Eigen::Vector3f& normal : told.normals) normal = turn * normal;
  const size_t alone = told.normals.size() / 2;
  const Eigen::AngleAxisf bump(0.3F, told.normals[alone].unitOrthogonal());
  told.normals[alone] = bump * told.normals[alone];
  LeanAsMesh(graph, mesh, 2, &told);
  for (size_t i = 0; i < told.normals.size(); i += 50) {
    // Its share in its neighbours' means is a hundredth.
    EXPECT_LT((told.normals[i] - mesh.vertices[i].normalized()).norm(), 0.01) << i;
  }
  EXPECT_NEAR((told.normals[alone] - mesh.vertices[alone].normalized()).norm(), 0.3, 0.03);
}

}  // namespace
}  // namespace s2gs
