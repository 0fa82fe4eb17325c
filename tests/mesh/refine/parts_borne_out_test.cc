#include "mesh/refine/parts_borne_out.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "mesh/surface/vertex_normals.h"
#include "tests/mesh/refine/sphere_photos.h"

namespace s2gs {
namespace {

constexpr double kBelowAll = -5;  // the top of a table far below the sphere

std::vector<uint8_t> NotBorneOut(const RefinementPhotoSource& source, TriangleMesh* mesh,
                                 double height = kBelowAll, int num_threads = 2) {
  Reporter silent;
  ComputeNormals(mesh);
  RefinementPhotos photos(num_threads, silent);
  photos.Load(source, *mesh, 1);
  return FindPartsNotBorneOut(photos, *mesh, height, num_threads);
}

// Appends a sphere of radius .15 that floats before the true one where x is largest.
void AddFloatingPart(TriangleMesh* mesh) {
  const auto first = static_cast<uint32_t>(mesh->vertices.size());
  const TriangleMesh part = Sphere(0.15, 30);
  for (const Eigen::Vector3f& vertex : part.vertices)
    mesh->vertices.push_back(vertex + Eigen::Vector3f(1.5F, 0, 0));
  for (const Triangle& triangle : part.triangles)
    mesh->triangles.emplace_back(first + triangle[0], first + triangle[1], first + triangle[2]);
}

// Measured means: .00 on the floating part, .78 on the sphere.
TEST(PartsBorneOut, AreNotThoseThatFloatBeforeTheTrueSurface) {
  const SpherePhotos photos(12, kThreeRings, Grain, 2);
  TriangleMesh mesh = Sphere(1, 110);
  const size_t num_true = mesh.vertices.size();
  AddFloatingPart(&mesh);
  const std::vector<uint8_t> flags = NotBorneOut(photos, &mesh);
  EXPECT_EQ(std::count(flags.begin(), flags.begin() + static_cast<int64_t>(num_true), 1), 0);
  EXPECT_EQ(std::count(flags.begin() + static_cast<int64_t>(num_true), flags.end(), 1),
            static_cast<int64_t>(mesh.vertices.size() - num_true));
  EXPECT_EQ(NotBorneOut(photos, &mesh, kBelowAll, 1), flags);
  // What lies lower than the top is no part.
  const std::vector<uint8_t> none = NotBorneOut(photos, &mesh, 0.5);
  EXPECT_EQ(std::count(none.begin(), none.end(), 1), 0);
}

// A cap that hangs together with the rest nowhere, and is a hundredth of it.
TEST(PartsBorneOut, AreTrueOnesHoweverSmall) {
  const SpherePhotos photos(12, kThreeRings, Grain, 2);
  TriangleMesh mesh = Sphere(1, 110);
  const auto is_in_gap = [](const Eigen::Vector3f& v) { return v.x() > 0.95F && v.x() < 0.97F; };
  std::vector<Triangle> kept;
  for (const Triangle& triangle : mesh.triangles) {
    const bool gap = is_in_gap(mesh.vertices[triangle[0]]) || is_in_gap(mesh.vertices[triangle[1]]) ||
                     is_in_gap(mesh.vertices[triangle[2]]);
    if (!gap) kept.push_back(triangle);
  }
  ASSERT_LT(kept.size(), mesh.triangles.size());
  mesh.triangles = kept;
  const std::vector<uint8_t> flags = NotBorneOut(photos, &mesh);
  EXPECT_EQ(std::count(flags.begin(), flags.end(), 1), 0);
}

// Photos of a plain surface say nothing of a part, and those that contradict the largest say nothing of
// others.
TEST(PartsBorneOut, AreJudgedWhereThereIsTextureAndABody) {
  TriangleMesh mesh = Sphere(1, 110);
  AddFloatingPart(&mesh);
  const std::vector<uint8_t> plain = NotBorneOut(SpherePhotos(12, kThreeRings, Plain, 2), &mesh);
  EXPECT_EQ(std::count(plain.begin(), plain.end(), 1), 0);
  TriangleMesh wrong = Sphere(0.8, 110);
  AddFloatingPart(&wrong);
  const std::vector<uint8_t> none = NotBorneOut(SpherePhotos(12, kThreeRings, Grain, 2), &wrong);
  EXPECT_EQ(std::count(none.begin(), none.end(), 1), 0);
}

}  // namespace
}  // namespace s2gs
