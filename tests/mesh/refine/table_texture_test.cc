#include "mesh/refine/table_texture.h"

#include <gtest/gtest.h>

#include <vector>

#include "mesh/surface/vertex_normals.h"
#include "tests/mesh/refine/sphere_photos.h"

namespace s2gs {
namespace {

// Noise of 3 grey levels is what patches without texture are told by.
TEST(TexturedShare, IsAllOfATexturedSurfaceAndNoneOfAPlainOne) {
  TriangleMesh mesh = Sphere(1.01, 40);
  ComputeNormals(&mesh);
  std::vector<uint32_t> all(mesh.vertices.size());
  for (uint32_t v = 0; v < all.size(); ++v) all[v] = v;
  Reporter silent;
  const auto share = [&](const RefinementPhotoSource& photos, const std::vector<uint32_t>& vertices) {
    return TexturedShare(photos, vertices, {}, mesh, silent);
  };
  const SpherePhotos textured(12, kThreeRings, Waves, 3);
  const SpherePhotos plain(12, kThreeRings, Plain, 3);
  ASSERT_TRUE(share(textured, all) && share(plain, all));
  EXPECT_GT(*share(textured, all), 0.95);
  EXPECT_LT(*share(plain, all), 0.05);
  EXPECT_FALSE(share(plain, {}));
}

}  // namespace
}  // namespace s2gs
