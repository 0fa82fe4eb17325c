// Depth maps to a mesh, from C++: a ring of cameras looks at a ball of radius 1 whose depths are computed
// here.
//
//   depth_to_mesh ball.glb

#include <cmath>
#include <cstdio>
#include <exception>
#include <vector>

#include "mesh/fusion/tsdf.h"
#include "mesh/io/mesh_files.h"
#include "mesh/surface/mesh_cleanup.h"

namespace {

// What the camera at `angle` around the ball, a little above or below it, would measure.
s2gs::DepthView Measure(double angle, double height) {
  const Eigen::Vector3d position(3 * std::cos(angle), 3 * std::sin(angle), height);
  Eigen::Matrix3d rotation;  // rows: the camera's x (right), y (down), z (forward) in the object's frame
  rotation.row(2) = -position.normalized();
  rotation.row(0) = rotation.row(2).cross(Eigen::RowVector3d(0, 0, 1)).normalized();
  rotation.row(1) = rotation.row(2).cross(rotation.row(0));
  s2gs::DepthView view;
  view.camera = {320, 240, 300, 300, 160, 120, {Eigen::Quaterniond(rotation), -rotation * position}};
  view.depths.resize(320 * 240);
  for (int y = 0; y < 240; ++y) {
    for (int x = 0; x < 320; ++x) {
      const Eigen::Vector3d ray((x + 0.5 - 160) / 300, (y + 0.5 - 120) / 300, 1);
      const double b = ray.dot(rotation * -position);  // |depth * ray - centre| = 1
      const double root = b * b - ray.squaredNorm() * (position.squaredNorm() - 1);
      if (root > 0) view.depths[y * 320 + x] = static_cast<float>((b - std::sqrt(root)) / ray.squaredNorm());
    }
  }
  return view;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    std::vector<s2gs::DepthView> views;
    for (int i = 0; i < 36; ++i) views.push_back(Measure(i * M_PI / 18, i % 2 == 0 ? 2.5 : -2.5));
    s2gs::Reporter silent;  // derive from it for progress and log lines
    s2gs::TsdfSummary summary;
    const s2gs::DepthViewList source(std::move(views));
    s2gs::TriangleMesh mesh = s2gs::MeshFromDepthMaps(source, s2gs::TsdfOptions(), silent, &summary);
    s2gs::CleanMesh(s2gs::MeshCleanupOptions(), silent, &mesh);
    s2gs::WriteMesh(argc > 1 ? argv[1] : "ball.ply", mesh);
    std::printf("%zu triangles, voxels of %.4f, %.2f s\n", mesh.triangles.size(), summary.voxel_size,
                summary.prepare_seconds + summary.fuse_seconds);
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
