#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <cstdint>
#include <vector>

#include "mesh/refine/mesh_refinement.h"
#include "mesh/refine/refinement_photos.h"
#include "mesh/surface/vertex_normals.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {
namespace {

constexpr int kNumPhotos = 8;
constexpr int kSide = 200;  // of a photo [px]
constexpr double kTopHeight = -0.2;
constexpr double kDistance = 5;

// Photos of a plain table from above, all around. Some show its top through what a mesh has
// before it, at marks of half of the photo's size.
class TablePhotos : public RefinementPhotoSource {
 public:
  explicit TablePhotos(int num_that_see) : num_that_see_(num_that_see) {
    for (int i = 0; i < kNumPhotos; ++i) {
      const double azimuth = 2 * kPi * i / kNumPhotos;
      const Eigen::Vector3d center = kDistance * Eigen::Vector3d(std::cos(azimuth), std::sin(azimuth), 1);
      Eigen::Matrix3d rotation;
      rotation.row(2) = -center.normalized();
      rotation.row(0) = Eigen::Vector3d::UnitZ().cross(center).normalized();
      rotation.row(1) = rotation.row(2).cross(rotation.row(0));
      ObjectView view{kSide, kSide, 300, 300, kSide / 2.0, kSide / 2.0, {}};
      view.cam_from_object.rotation = Eigen::Quaterniond(rotation);
      view.cam_from_object.translation = -(rotation * center);
      views_.push_back(view);
    }
  }
  int size() const override { return kNumPhotos; }
  const ObjectView& Camera(int index) const override { return views_[index]; }
  Image8 Load(int /*index*/) const override {
    return {kSide, kSide, 1, std::vector<uint8_t>(static_cast<size_t>(kSide) * kSide, 120)};
  }
  Image8 LoadPlaneSeen(int index) const override {
    const uint8_t mark = index < num_that_see_ ? 255 : 254;
    return {kSide / 2, kSide / 2, 1, std::vector<uint8_t>(static_cast<size_t>(kSide) * kSide / 4, mark)};
  }
  double SeenHeight() const override { return kTopHeight; }

 private:
  int num_that_see_;
  std::vector<ObjectView> views_;
};

// A level square of 21 x 21 vertices, half as wide as the photos.
TriangleMesh Level(double height) {
  constexpr int kCount = 21;
  TriangleMesh mesh;
  for (int j = 0; j < kCount; ++j) {
    for (int i = 0; i < kCount; ++i) {
      mesh.vertices.emplace_back(0.08F * (i - 10), 0.08F * (j - 10), static_cast<float>(height));
    }
  }
  for (uint32_t j = 0; j + 1 < kCount; ++j) {
    for (uint32_t i = 0; i + 1 < kCount; ++i) {
      const uint32_t at = j * kCount + i;
      mesh.triangles.emplace_back(at, at + 1, at + kCount);
      mesh.triangles.emplace_back(at + 1, at + kCount + 1, at + kCount);
    }
  }
  ComputeNormals(&mesh);
  return mesh;
}

size_t CountSeenThrough(int num_that_see, const TriangleMesh& mesh) {
  Reporter silent;
  RefinementPhotos photos(2, silent);
  photos.Load(TablePhotos(num_that_see), mesh, 1);
  size_t count = 0;
  for (const uint8_t flag : photos.FindSeenThrough(mesh, photos.FindVisible(mesh, {kMinSeenCosine, 0})))
    count += flag;
  return count;
}

TEST(SeenThrough, IsWhatTwoPhotosSeeThePlaneBehind) {
  const TriangleMesh web = Level(kTopHeight + 0.3);
  EXPECT_EQ(CountSeenThrough(0, web), 0U);
  EXPECT_EQ(CountSeenThrough(1, web), 0U);
  EXPECT_EQ(CountSeenThrough(2, web), web.vertices.size());
  // The plane itself, and what lies in a pixel's height over it or below.
  const double pixel = std::sqrt(2.0) * kDistance / 300;
  for (const double over : {-0.3, 0.0, 1.5 * pixel}) {
    EXPECT_EQ(CountSeenThrough(kNumPhotos, Level(kTopHeight + over)), 0U) << over;
  }
}

// The mesh reaches beyond the photos on all sides: what they do not show, they do not see through.
TEST(SeenThrough, EndsAtThePhotosBorders) {
  const TablePhotos source(kNumPhotos);
  TriangleMesh web = Level(kTopHeight + 0.3);
  for (Eigen::Vector3f& vertex : web.vertices) vertex.head<2>() *= 8;
  Reporter silent;
  RefinementPhotos photos(2, silent);
  photos.Load(source, web, 1);
  const std::vector<VertexFlags> all(kNumPhotos, [&] {
    VertexFlags flags(web.vertices.size());
    for (size_t i = 0; i < web.vertices.size(); ++i) flags.Set(i);
    return flags;
  }());
  const std::vector<uint8_t> seen = photos.FindSeenThrough(web, all);
  size_t inside = 0;
  for (size_t i = 0; i < web.vertices.size(); ++i) {
    int count = 0;
    for (int k = 0; k < kNumPhotos; ++k) {
      const ObjectView& view = source.Camera(k);
      const Eigen::Vector3d x = view.cam_from_object * web.vertices[i].cast<double>();
      const Eigen::Vector2d pixel(view.fx * x.x() / x.z() + view.cx, view.fy * x.y() / x.z() + view.cy);
      count += pixel.minCoeff() >= 0 && pixel.maxCoeff() < kSide ? 1 : 0;
    }
    EXPECT_EQ(seen[i], count >= 2 ? 1 : 0) << web.vertices[i].transpose();
    inside += seen[i];
  }
  EXPECT_GT(inside, 20U);
  EXPECT_LT(inside, web.vertices.size() - 20);
}

TEST(SeenThrough, GoesFromTheMeshAndNothingElse) {
  Reporter silent;
  MeshRefinementOptions options;
  options.num_threads = 2;
  TriangleMesh mesh = Level(kTopHeight + 0.3);
  const TriangleMesh top = Level(kTopHeight);
  const auto first = static_cast<uint32_t>(mesh.vertices.size());
  const size_t num_of_web = mesh.triangles.size();
  mesh.vertices.insert(mesh.vertices.end(), top.vertices.begin(), top.vertices.end());
  for (const auto& t : top.triangles) mesh.triangles.emplace_back(t[0] + first, t[1] + first, t[2] + first);
  TriangleMesh kept = mesh;
  const MeshRefinementSummary summary = RefineMesh(TablePhotos(2), options, silent, &mesh);
  EXPECT_EQ(summary.num_seen_through, static_cast<int64_t>(num_of_web));
  for (const Eigen::Vector3f& vertex : mesh.vertices) EXPECT_FLOAT_EQ(vertex.z(), kTopHeight);
  EXPECT_FALSE(mesh.triangles.empty());
  options.drop_seen_through = false;
  EXPECT_EQ(RefineMesh(TablePhotos(2), options, silent, &kept).num_seen_through, 0);
}

}  // namespace
}  // namespace s2gs
