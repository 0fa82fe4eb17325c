#include "mesh/refine/depth_outlines.h"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>
#include <vector>

#include "sfm_split/base/angles.h"
#include "tests/mesh/refine/sphere_photos.h"

namespace s2gs {
namespace {

// Depth maps of a sphere from two rings, with a wall behind it where `wall` is not infinite: the depth
// along z of what each value's place shows.
std::vector<DepthView> SphereDepths(double wall, const Eigen::Vector2d& first_position, double radius = 1) {
  std::vector<DepthView> views;
  for (const double elevation : {0.1, 0.6}) {
    for (int i = 0; i < 18; ++i) {
      DepthView view;
      view.camera = LookAtMiddle(2 * kPi * (i + elevation) / 18, elevation);
      view.first_position = first_position;
      const Eigen::Matrix3d rotation = view.camera.cam_from_object.rotation.toRotationMatrix();
      const Eigen::Vector3d center = -(rotation.transpose() * view.camera.cam_from_object.translation);
      for (int y = 0; y < kSide; ++y) {
        for (int x = 0; x < kSide; ++x) {
          const Eigen::Vector3d in_camera((x + first_position.x() - view.camera.cx) / view.camera.fx,
                                          (y + first_position.y() - view.camera.cy) / view.camera.fy, 1);
          const Eigen::Vector3d ray = rotation.transpose() * in_camera;  // its depth along z is 1
          const double b = center.dot(ray) / ray.squaredNorm();
          const double root = b * b - (center.squaredNorm() - radius * radius) / ray.squaredNorm();
          view.depths.push_back(static_cast<float>(root > 0 ? -b - std::sqrt(root) : wall));
        }
      }
      views.push_back(std::move(view));
    }
  }
  return views;
}

DepthOutlineSummary Move(const std::vector<DepthView>& views, TriangleMesh* mesh, int num_threads = 0,
                         std::optional<double> table_height = std::nullopt) {
  Reporter silent;
  return MoveToDepthOutlines(DepthViewList(views), table_height, num_threads, silent, mesh);
}

constexpr double kNoWall = 0;  // a map's value where nothing is known
constexpr double kFarWall = kDistance + 2;

// Of the part that the cameras face. Measured [px]: mean .16 and rms .16 at most, which the pull leaves.
TEST(DepthOutlines, TakeAnOffsetOffThatFusionLeft) {
  for (const double wall : {kNoWall, kFarWall}) {
    for (const Eigen::Vector2d& first : {Eigen::Vector2d(0, 0), Eigen::Vector2d(0.5, 0.5)}) {
      const std::vector<DepthView> views = SphereDepths(wall, first);
      for (const double offset : {-2.0, 0.0, 1.5}) {
        TriangleMesh mesh = Sphere(1 + offset * kPixel, 110);
        const DepthOutlineSummary summary = Move(views, &mesh);
        const auto [mean, rms] = DistanceFromSphere(mesh);
        EXPECT_LT(std::abs(mean), 0.2) << offset;
        EXPECT_LT(rms, 0.2) << offset;
        EXPECT_GT(summary.num_vertices, static_cast<int64_t>(mesh.vertices.size()) / 2);
        EXPECT_GT(summary.num_outlines, summary.num_vertices);
        EXPECT_NEAR(summary.mean_offset_px, -offset, 0.5);  // a pixel where the mesh's middle is
        EXPECT_NEAR(mesh.normals[500].norm(), 1, 1e-5);
      }
    }
  }
}

// What the mask leaves out is not there, however near the maps have something.
TEST(DepthOutlines, EndWhereTheMaskEnds) {
  std::vector<DepthView> views = SphereDepths(kNoWall, {0.5, 0.5}, 1 + kPixel);
  TriangleMesh mesh = Sphere(1, 110);
  Move(views, &mesh);
  EXPECT_NEAR(DistanceFromSphere(mesh).first, 1, 0.15);
  const std::vector<DepthView> true_views = SphereDepths(kNoWall, {0.5, 0.5});
  for (size_t k = 0; k < views.size(); ++k) {
    views[k].mask = {kSide, kSide, 1, {}};
    for (const float depth : true_views[k].depths) views[k].mask.pixels.push_back(depth > 0 ? 255 : 0);
  }
  mesh = Sphere(1, 110);
  Move(views, &mesh);
  EXPECT_NEAR(DistanceFromSphere(mesh).first, 0, 0.15);
}

// A mask is known for pixels, whose middles COLMAP's maps do not have their values at. Measured: .01 px.
TEST(DepthOutlines, AreWhereTheyWereWithAMaskOfPixels) {
  std::vector<DepthView> views = SphereDepths(kNoWall, {0, 0});
  const std::vector<DepthView> of_pixels = SphereDepths(kNoWall, {0.5, 0.5});
  for (size_t k = 0; k < views.size(); ++k) {
    views[k].mask = {kSide, kSide, 1, {}};
    for (const float depth : of_pixels[k].depths) views[k].mask.pixels.push_back(depth > 0 ? 255 : 0);
  }
  TriangleMesh mesh = Sphere(1, 110);
  Move(views, &mesh);
  EXPECT_NEAR(DistanceFromSphere(mesh).first, 0, 0.06);
}

// An outline that something nearer makes is not the surface's.
TEST(DepthOutlines, AreNotThoseOfWhatStandsBefore) {
  std::vector<DepthView> views = SphereDepths(kNoWall, {0.5, 0.5});
  for (DepthView& view : views) {
    for (int y = 0; y < kSide; ++y)
      for (int x = 0; x < kSide; ++x)
        if (std::hypot(x - kSide / 2.0, y - kSide / 2.0) > 100) view.depths[y * kSide + x] = 1;
  }
  TriangleMesh mesh = Sphere(1 - 2 * kPixel, 110);
  EXPECT_EQ(Move(views, &mesh).num_vertices, 0);
}

TEST(DepthOutlines, GiveTheSameWithAnyNumberOfThreads) {
  const std::vector<DepthView> views = SphereDepths(kNoWall, {0, 0});
  TriangleMesh one = Sphere(1 - 2 * kPixel, 60);
  TriangleMesh three = one;
  Move(views, &one, 1);
  Move(views, &three, 3);
  EXPECT_EQ(one.vertices, three.vertices);
}

TEST(DepthOutlines, LeaveWhatIsNoHigherThanATable) {
  const TriangleMesh before = Sphere(1 - 2 * kPixel, 110);
  TriangleMesh mesh = before;
  Move(SphereDepths(kNoWall, {0, 0}), &mesh, 0, -0.2);
  double sum = 0;
  int count = 0;
  for (size_t i = 0; i < mesh.vertices.size(); ++i) {
    const float height = before.vertices[i].z();
    if (height <= -0.2F) {
      ASSERT_EQ(mesh.vertices[i], before.vertices[i]);
    } else if (height > 0 && height < 0.6F) {
      sum += (mesh.vertices[i].norm() - 1) / kPixel;
      ++count;
    }
  }
  EXPECT_LT(std::abs(sum / count), 0.15);
}

TEST(DepthOutlines, LeaveAnEmptyMeshEmpty) {
  TriangleMesh mesh;
  EXPECT_EQ(Move(SphereDepths(kNoWall, {0, 0}), &mesh).num_outlines, 0);
}

}  // namespace
}  // namespace s2gs
