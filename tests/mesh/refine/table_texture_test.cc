#include "mesh/refine/table_texture.h"

#include <gtest/gtest.h>

#include <mutex>
#include <set>
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

// Of more photos than 24 so many, evenly chosen.
TEST(TexturedShare, LooksAtSomeOfManyPhotos) {
  class Counted : public RefinementPhotoSource {
   public:
    explicit Counted(const RefinementPhotoSource& photos) : photos_(photos) {}
    int size() const override { return photos_.size(); }
    const ObjectView& Camera(int index) const override { return photos_.Camera(index); }
    Image8 Load(int index) const override {
      const std::lock_guard lock(mutex_);
      loaded_.insert(index);
      return photos_.Load(index);
    }
    std::set<int> loaded() const { return loaded_; }

   private:
    const RefinementPhotoSource& photos_;
    mutable std::mutex mutex_;
    mutable std::set<int> loaded_;
  };
  TriangleMesh mesh = Sphere(1.01, 40);
  ComputeNormals(&mesh);
  std::vector<uint32_t> all(mesh.vertices.size());
  for (uint32_t v = 0; v < all.size(); ++v) all[v] = v;
  Reporter silent;
  for (const int num_around : {8, 10}) {
    const SpherePhotos photos(num_around, kThreeRings, Plain);
    const Counted counted(photos);
    ASSERT_TRUE(TexturedShare(counted, all, {}, mesh, silent));
    std::set<int> expected;
    for (int i = 0; i < 24; ++i) expected.insert(i * photos.size() / 24);
    EXPECT_EQ(counted.loaded(), expected);
  }
}

}  // namespace
}  // namespace s2gs
