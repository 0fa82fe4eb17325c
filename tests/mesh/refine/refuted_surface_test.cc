#include "mesh/refine/refuted_surface.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "mesh/surface/vertex_normals.h"
#include "tests/mesh/refine/sphere_photos.h"
#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

std::vector<uint8_t> Refuted(const RefinementPhotoSource& source, TriangleMesh* mesh, int num_threads = 2) {
  Reporter silent;
  ComputeNormals(mesh);
  RefinementPhotos photos(num_threads, silent);
  photos.Load(source, *mesh, 1);
  return FindRefuted(photos, VertexGraph(*mesh), *mesh, num_threads);
}

int64_t CountOf(const std::vector<uint8_t>& flags) { return std::count(flags.begin(), flags.end(), 1); }

TEST(RefutedSurface, IsAFalseFrontAndNothingElse) {
  const SpherePhotos photos(12, kThreeRings, Grain, 2);
  std::vector<size_t> front;
  TriangleMesh mesh = SphereWithFalseFront(20, &front);
  const std::vector<uint8_t> refuted = Refuted(photos, &mesh);
  int64_t of_front = 0;
  int64_t elsewhere = 0;
  for (const size_t i : front) of_front += refuted[i];
  for (size_t i = 0; i < refuted.size(); ++i) elsewhere += mesh.vertices[i].x() < 0.9F ? refuted[i] : 0;
  EXPECT_GT(of_front, 0.95 * static_cast<double>(front.size()));
  EXPECT_EQ(elsewhere, 0);
  EXPECT_EQ(Refuted(photos, &mesh, 1), refuted);
}

// A highlight that stands still while the sphere turns, brighter than its texture.
TEST(RefutedSurface, IsNoneOfATrueOneUnderMovingLight) {
  const auto photos_of = [](const SpherePhotos::Texture& texture) {
    return SpherePhotos(12, kThreeRings, texture, 2, {-0.8, -0.5, -0.5});
  };
  TriangleMesh mesh = Sphere(1, 110);
  EXPECT_EQ(CountOf(Refuted(photos_of([](const Eigen::Vector3d& x) { return 70 + 0.3 * (Grain(x) - 120); }),
                            &mesh)),
            0);
  EXPECT_EQ(CountOf(Refuted(photos_of(Plain), &mesh)), 0);
}

// A band of 8 pixels, beside which every photo shows something else.
TEST(RefutedSurface, IsNoneOfAThinPart) {
  RandomNumbers random(5);
  const double half = 4 * kPixel;
  const SpherePhotos photos(
      12, {0},
      [&](const Eigen::Vector3d& x) { return std::abs(x.z()) < half ? Grain(x) : random.Uniform(0, 255); },
      1);
  const TriangleMesh sphere = Sphere(1, 220);
  TriangleMesh band = sphere;
  band.triangles.clear();
  for (const auto& triangle : sphere.triangles) {
    bool is_in = true;
    for (const uint32_t corner : triangle)
      is_in = is_in && std::abs(sphere.vertices[corner].z()) < half + 0.5 * kPixel;
    if (is_in) band.triangles.push_back(triangle);
  }
  ASSERT_GT(band.triangles.size(), 800U);
  // Measured: one.
  EXPECT_LT(CountOf(Refuted(photos, &band)), 0.005 * static_cast<double>(band.triangles.size()));
}

}  // namespace
}  // namespace s2gs
