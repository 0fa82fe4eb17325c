// A dense workspace of ours, with exact depth and normal maps, goes through COLMAP's own fusion and meshers
// and through tsdf_mesher. Needs the `colmap` executable; nothing here needs a GPU.

#include "mesh/io/dense_workspace.h"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <iterator>
#include <string>
#include <vector>

#include "mesh/surface/triangle_mesh.h"
#include "plugin/outputs/mesh_workspace.h"
#include "s2gs/image/image_file.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/scene/io/colmap_maps.h"
#include "tests/mesh/fusion/analytic_views.h"
#include "tests/mesh/surface/mesh_topology.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr double kRadius = 0.8;

testing::AssertionResult RunColmap(const std::string& arguments, const fs::path& log) {
  const std::string command =
      "QT_QPA_PLATFORM=offscreen colmap " + arguments + " > '" + log.string() + "' 2>&1";
  if (std::system(command.c_str()) == 0) return testing::AssertionSuccess();
  std::ifstream stream(log);
  return testing::AssertionFailure() << command << '\n' << stream.rdbuf();
}

std::string NameOf(int view) { return "ring/view" + std::to_string(view) + ".png"; }

// The sphere's points as the model knows them: those that face a view are in its track.
ColmapModel ModelOf(const std::vector<DepthView>& views) {
  ColmapModel model;
  const ObjectView& first = views.front().camera;
  Camera camera;
  camera.camera_id = 1;
  camera.model = CameraModelId::kPinhole;
  camera.width = static_cast<uint64_t>(first.width);
  camera.height = static_cast<uint64_t>(first.height);
  camera.params = {first.fx, first.fy, first.cx, first.cy};
  model.cameras[1] = camera;
  for (uint64_t p = 1; p <= 200; ++p) {
    const double z = 1 - (static_cast<double>(p) - 0.5) / 100;
    const double angle = static_cast<double>(p) * kPi * (3 - std::sqrt(5.0));
    model.points3D[p].point3D_id = p;
    model.points3D[p].xyz = kRadius * Eigen::Vector3d(std::sqrt(1 - z * z) * std::cos(angle),
                                                      std::sqrt(1 - z * z) * std::sin(angle), z);
  }
  for (size_t i = 0; i < views.size(); ++i) {
    const auto id = static_cast<uint32_t>(i + 1);
    ColmapImage& image = model.images[id];
    image.image_id = id;
    image.name = NameOf(static_cast<int>(i));
    image.camera_id = 1;
    image.cam_from_world = views[i].camera.cam_from_object;
    for (auto& [point_id, point] : model.points3D) {
      const Eigen::Vector3d x_in_cam = image.cam_from_world * point.xyz;
      if (x_in_cam.dot(image.cam_from_world.rotation * point.xyz) > -0.5) continue;
      const Eigen::Vector2d xy(first.fx * x_in_cam.x() / x_in_cam.z() + first.cx,
                               first.fy * x_in_cam.y() / x_in_cam.z() + first.cy);
      point.track.push_back({id, static_cast<uint32_t>(image.points2D.size())});
      image.points2D.push_back({xy, point_id});
    }
  }
  for (auto point = model.points3D.begin(); point != model.points3D.end();) {
    point = point->second.track.empty() ? model.points3D.erase(point) : std::next(point);
  }
  return model;
}

template <typename Points>
double RmsRadiusError(const Points& points) {
  double sum = 0;
  for (const auto& point : points) sum += std::pow(point.template cast<double>().norm() - kRadius, 2);
  return std::sqrt(sum / static_cast<double>(points.size()));
}

TEST(DenseWorkspaceInterop, ColmapsToolsAndOursMeshIt) {
  if (std::system("QT_QPA_PLATFORM=offscreen colmap help > /dev/null 2>&1") != 0) {
    GTEST_SKIP() << "no `colmap` on PATH";
  }
  AnalyticViewOptions options;
  options.num_views = 30;
  options.first_position = kColmapMapPosition;
  options.with_normals = true;
  options.with_colors = true;
  options.with_mask = true;
  const std::vector<DepthView> views = AnalyticViews({SphereShape(kRadius)}, options);
  const TemporaryFolder folder;
  const Workspace workspace{folder.path()};
  const ColmapModel model = ModelOf(views);
  for (size_t i = 0; i < views.size(); ++i) {
    const fs::path image = workspace.Images() / NameOf(static_cast<int>(i));
    const fs::path mask = workspace.Mask(NameOf(static_cast<int>(i)));
    fs::create_directories(image.parent_path());
    fs::create_directories(mask.parent_path());
    WriteImage(image, views[i].colors);
    WriteImage(mask, views[i].mask);
  }
  Reporter silent;
  WriteDenseWorkspace(workspace.Dense(), model,
                      {workspace.ObjectModel(), workspace.Images(), workspace.Masks()}, silent);
  for (size_t i = 0; i < views.size(); ++i) {
    const std::string name = NameOf(static_cast<int>(i));
    const ObjectView& camera = views[i].camera;
    WriteColmapMap(workspace.DepthMap(name), {camera.width, camera.height, 1, views[i].depths});
    WriteColmapMap(workspace.NormalMap(name), {camera.width, camera.height, 3, views[i].normals});
  }

  const std::string dense = "'" + workspace.Dense().string() + "'";
  const std::string fused = (workspace.Dense() / "fused.ply").string();
  const fs::path log = folder / "log";
  ASSERT_TRUE(RunColmap("stereo_fusion --workspace_path " + dense +
                            " --input_type geometric --output_path '" + fused +
                            "' --StereoFusion.min_num_pixels 3 --StereoFusion.num_threads 1",
                        log));
  const TriangleMesh cloud = ReadPlyMesh(fused);
  EXPECT_GT(cloud.vertices.size(), 8000u);          // measured 11458
  EXPECT_LT(RmsRadiusError(cloud.vertices), 2e-3);  // measured 9e-4

  ASSERT_TRUE(RunColmap(
      "poisson_mesher --input_path '" + fused + "' --output_path '" + workspace.PoissonMesh().string() +
          "' --PoissonMeshing.depth 7 --PoissonMeshing.trim 0 --PoissonMeshing.num_threads 1",
      log));
  const TriangleMesh poisson = ReadPlyMesh(workspace.PoissonMesh());
  EXPECT_GT(poisson.triangles.size(), 2000u);
  EXPECT_LT(RmsRadiusError(poisson.vertices), 2e-3);

  const testing::AssertionResult delaunay_ran =
      RunColmap("delaunay_mesher --input_type dense --input_path " + dense + " --output_path '" +
                    workspace.DelaunayMesh().string() + "' --DelaunayMeshing.num_threads 1",
                log);
  if (ReadAll(log).find("requires CGAL") != std::string::npos) {
    std::cout << "delaunay_mesher left out: this `colmap` is built without CGAL\n";
  } else {
    ASSERT_TRUE(delaunay_ran);
    const TriangleMesh delaunay = ReadPlyMesh(workspace.DelaunayMesh());
    EXPECT_GT(delaunay.triangles.size(), 1000u);
    EXPECT_LT(RmsRadiusError(delaunay.vertices), 4e-3);
  }

  TsdfMesherOptions mesher;
  mesher.tsdf.backend = TsdfBackend::kCpu;
  mesher.max_error_voxels = 0;
  const TsdfMesherSummary summary = MeshWorkspace(workspace, mesher, silent);
  EXPECT_EQ(summary.num_depth_maps, 30);
  EXPECT_EQ(summary.num_masks, 30);
  const TriangleMesh ours = ReadPlyMesh(workspace.TsdfMesh());
  EXPECT_LT(RmsRadiusError(ours.vertices), 2e-4);  // the maps are exact; voxels of 1.2e-2
  const MeshTopology topology = TopologyOf(ours);
  EXPECT_EQ(topology.num_boundary_edges, 0);
  EXPECT_EQ(topology.euler_characteristic, 2);
  double worst = 0;
  for (size_t i = 0; i < ours.vertices.size(); ++i) {
    const Eigen::Array3d expected = AnalyticColor(ours.vertices[i].cast<double>().normalized());
    worst = std::max(worst, (ours.colors[i].cast<double>().array() - expected).abs().maxCoeff());
  }
  EXPECT_LT(worst, 6);

  mesher.max_error_voxels = TsdfMesherOptions().max_error_voxels;
  MeshWorkspace(workspace, mesher, silent);
  const TriangleMesh simplified = ReadPlyMesh(workspace.TsdfMesh());
  EXPECT_LT(simplified.vertices.size(), ours.vertices.size() / 2);
  EXPECT_LT(RmsRadiusError(simplified.vertices), 2.4e-3);  // measured 1.5e-3, an eighth of a voxel
  EXPECT_EQ(TopologyOf(simplified).euler_characteristic, 2);
}

}  // namespace
}  // namespace s2gs
