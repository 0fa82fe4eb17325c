#include "mesh/refine/surface_carving.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "mesh/surface/vertex_normals.h"
#include "tests/mesh/refine/sphere_photos.h"

namespace s2gs {
namespace {

std::vector<uint32_t> Carve(const RefinementPhotoSource& source, TriangleMesh* mesh, int num_threads = 2) {
  Reporter silent;
  ComputeNormals(mesh);
  RefinementPhotos photos(num_threads, silent);
  photos.Load(source, *mesh, 1);
  return CarveContradicted(photos, VertexGraph(*mesh), 8, num_threads, mesh);
}

TEST(SurfaceCarving, LetsAFalseFrontSinkToTheSurface) {
  const SpherePhotos photos(12, kThreeRings, Waves);
  // A bulge of 9 pixels, further than the passes look.
  TriangleMesh mesh = Sphere(1, 110);
  std::vector<size_t> bulge;
  for (size_t i = 0; i < mesh.vertices.size(); ++i) {
    const double angle = std::acos(std::clamp(static_cast<double>(mesh.vertices[i].x()), -1.0, 1.0));
    if (angle > 0.25) continue;
    const double rise = std::min(1.0, (0.25 - angle) / 0.08);
    mesh.vertices[i] *= static_cast<float>(1 + 9 * rise * kPixel);
    if (rise == 1) bulge.push_back(i);
  }
  const TriangleMesh start = mesh;
  const auto mean_height = [&] {
    double sum = 0;
    for (const size_t i : bulge) sum += std::abs(mesh.vertices[i].cast<double>().norm() - 1) / kPixel;
    return sum / static_cast<double>(bulge.size());
  };
  ASSERT_GT(bulge.size(), 40U);
  ASSERT_NEAR(mean_height(), 9, 1e-3);
  EXPECT_FALSE(Carve(photos, &mesh).empty());
  EXPECT_LT(mean_height(), 3);  // measured: 1.43
  // The other side of the sphere has not moved.
  for (size_t i = 0; i < mesh.vertices.size(); ++i) {
    if (start.vertices[i].x() > 0) continue;
    EXPECT_EQ(mesh.vertices[i], start.vertices[i]);
  }
  TriangleMesh again = start;
  Carve(photos, &again, 1);
  EXPECT_EQ(again.vertices, mesh.vertices);
}

TEST(SurfaceCarving, PutsBackWhatAgreesNowhere) {
  // Photos that have nothing in common: at every depth they contradict each other.
  const SpherePhotos photos(12, kThreeRings, Plain, 60);
  TriangleMesh mesh = Sphere(1, 60);
  const TriangleMesh start = mesh;
  EXPECT_TRUE(Carve(photos, &mesh).empty());
  EXPECT_EQ(mesh.vertices, start.vertices);
  // And without texture nothing is contradicted.
  const SpherePhotos plain(12, kThreeRings, Plain, 2);
  EXPECT_TRUE(Carve(plain, &mesh).empty());
  EXPECT_EQ(mesh.vertices, start.vertices);
}

}  // namespace
}  // namespace s2gs
