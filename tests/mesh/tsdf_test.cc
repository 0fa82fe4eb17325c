#include "mesh/tsdf.h"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "mesh/marching_cubes.h"
#include "mesh/tsdf_view.h"
#include "s2gs/core/gpu_info.h"
#include "tests/bad_input.h"
#include "tests/mesh/analytic_views.h"
#include "tests/mesh/mesh_topology.h"
#include "tests/random_numbers.h"

namespace s2gs {
namespace {

bool HasGpu() {
  const std::vector<GpuInfo> gpus = ListGpus();
  return std::any_of(gpus.begin(), gpus.end(), [](const GpuInfo& gpu) { return gpu.is_usable; });
}

TriangleMesh Fuse(std::vector<DepthView> views, const TsdfOptions& options, TsdfSummary* summary = nullptr) {
  Reporter silent;
  return MeshFromDepthMaps(DepthViewList(std::move(views)), options, silent, summary);
}

// Signed distances of the vertices to a surface [voxels].
struct Deviation {
  double mean = 0;
  double rms = 0;
  double worst = 0;
};
template <typename Distance>
Deviation DeviationOf(const TriangleMesh& mesh, double voxel_size, const Distance& distance) {
  Deviation result;
  for (const Eigen::Vector3f& vertex : mesh.vertices) {
    const double d = distance(vertex.cast<double>()) / voxel_size;
    result.mean += d;
    result.rms += d * d;
    result.worst = std::max(result.worst, std::abs(d));
  }
  result.mean /= static_cast<double>(mesh.vertices.size());
  result.rms = std::sqrt(result.rms / static_cast<double>(mesh.vertices.size()));
  return result;
}

double BoxDistance(const Eigen::Vector3d& x, const Eigen::Vector3d& half) {
  const Eigen::Vector3d q = x.cwiseAbs() - half;
  return q.cwiseMax(0).norm() + std::min(q.maxCoeff(), 0.0);
}

class TsdfOnBackend : public testing::TestWithParam<TsdfBackend> {
 protected:
  void SetUp() override {
    if (GetParam() == TsdfBackend::kCuda && !HasGpu()) GTEST_SKIP() << "no GPU that this program can use";
  }
};

TEST_P(TsdfOnBackend, SphereIsUnbiased) {
  for (const bool with_normals : {false, true}) {
    AnalyticViewOptions view_options;
    view_options.with_normals = with_normals;
    const std::vector<DepthView> views = AnalyticViews({SphereShape(0.8)}, view_options);
    for (const double truncation : {4.0, 5.0, 6.0, 8.0}) {
      TsdfOptions options;
      options.truncation_voxels = truncation;
      options.backend = GetParam();
      TsdfSummary summary;
      const TriangleMesh mesh = Fuse(views, options, &summary);
      EXPECT_EQ(summary.backend, GetParam());
      // The camera is at a distance of 4 with a focal length of 300 px; the visible surface is nearer.
      EXPECT_GT(summary.voxel_size, 3.2 / 330);
      EXPECT_LT(summary.voxel_size, 4.0 / 300);
      const Deviation deviation =
          DeviationOf(mesh, summary.voxel_size, [](const Eigen::Vector3d& x) { return x.norm() - 0.8; });
      RecordProperty("mean", std::to_string(deviation.mean));
      EXPECT_LT(std::abs(deviation.mean), 0.05) << truncation;
      EXPECT_LT(deviation.rms, 0.1) << truncation;
      EXPECT_LT(deviation.worst, 0.5) << truncation;
      const MeshTopology topology = TopologyOf(mesh);
      EXPECT_EQ(topology.num_boundary_edges, 0);
      EXPECT_EQ(topology.num_bad_edges, 0);
      EXPECT_EQ(topology.num_components, 1);
      EXPECT_EQ(topology.euler_characteristic, 2);
      EXPECT_NEAR(topology.area, 4 * M_PI * 0.64, 0.01 * 4 * M_PI * 0.64);
      EXPECT_NEAR(topology.volume, 4 * M_PI / 3 * 0.512, 0.005 * 4 * M_PI / 3 * 0.512);
      printf("sphere normals %d truncation %g: mean %.4f rms %.4f worst %.4f area %.5f vol %.5f\n",
             with_normals, truncation, deviation.mean, deviation.rms, deviation.worst,
             topology.area / (4 * M_PI * .64), topology.volume / (4 * M_PI / 3 * 0.512));
    }
  }
}

TEST_P(TsdfOnBackend, BoxIsUnbiased) {
  const Eigen::Vector3d half(0.5, 0.63, 0.4);
  // Askew to the grid of voxels.
  const Rigid3 object_from_box = {
      Eigen::Quaterniond(Eigen::AngleAxisd(0.5, Eigen::Vector3d(1, 2, 3).normalized())), {0.1, -0.2, 0.05}};
  AnalyticViewOptions view_options;
  view_options.num_views = 60;
  const std::vector<DepthView> views = AnalyticViews({BoxShape(half, object_from_box)}, view_options);
  for (const double truncation : {4.0, 5.0, 6.0, 8.0}) {
    TsdfOptions options;
    options.truncation_voxels = truncation;
    options.backend = GetParam();
    TsdfSummary summary;
    const TriangleMesh mesh = Fuse(views, options, &summary);
    EXPECT_EQ(summary.backend, GetParam());
    const Rigid3 box_from_object = object_from_box.Inverse();
    const Deviation deviation = DeviationOf(mesh, summary.voxel_size, [&](const Eigen::Vector3d& x) {
      return BoxDistance(box_from_object * x, half);
    });
    EXPECT_LT(std::abs(deviation.mean), 0.1) << truncation;
    EXPECT_LT(deviation.rms, 0.2) << truncation;
    const MeshTopology topology = TopologyOf(mesh);
    EXPECT_EQ(topology.num_boundary_edges, 0);
    EXPECT_EQ(topology.num_bad_edges, 0);
    EXPECT_EQ(topology.num_components, 1);
    EXPECT_EQ(topology.euler_characteristic, 2);
    const double area = 8 * (half.x() * half.y() + half.y() * half.z() + half.z() * half.x());
    EXPECT_NEAR(topology.area, area, 0.01 * area);
    printf("box truncation %g: mean %.4f rms %.4f worst %.4f area %.5f\n", truncation, deviation.mean,
           deviation.rms, deviation.worst, topology.area / area);
  }
}

std::string BackendName(const testing::TestParamInfo<TsdfBackend>& info) {
  return info.param == TsdfBackend::kCpu ? "Cpu" : "Cuda";
}
INSTANTIATE_TEST_SUITE_P(Backends, TsdfOnBackend, testing::Values(TsdfBackend::kCpu, TsdfBackend::kCuda),
                         BackendName);

}  // namespace
}  // namespace s2gs
