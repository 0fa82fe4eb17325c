#include "mesh/fusion/tsdf.h"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "mesh/fusion/marching_cubes.h"
#include "mesh/fusion/tsdf_view.h"
#include "s2gs/core/gpu_info.h"
#include "sfm_split/base/angles.h"
#include "tests/mesh/fusion/analytic_views.h"
#include "tests/mesh/surface/mesh_topology.h"
#include "tests/support/bad_input.h"
#include "tests/support/measured_bound.h"
#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

// Voxels of one pixel of the depth maps: what the bounds of this file were measured with.
TsdfOptions PixelVoxels() {
  TsdfOptions options;
  options.voxel_size_pixels = 1;
  return options;
}

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

const char* NameOf(TsdfBackend backend) { return backend == TsdfBackend::kCpu ? "cpu" : "cuda"; }

class TsdfOnBackend : public testing::TestWithParam<TsdfBackend> {
 protected:
  void SetUp() override {
    if (GetParam() == TsdfBackend::kCuda && !HasGpu()) GTEST_SKIP() << "no GPU that this program can use";
  }
};

TEST_P(TsdfOnBackend, SphereIsUnbiased) {
  double bias = 0;
  double worst = 0;
  for (const bool with_normals : {false, true}) {
    AnalyticViewOptions view_options;
    view_options.with_normals = with_normals;
    const std::vector<DepthView> views = AnalyticViews({SphereShape(0.8)}, view_options);
    for (const double truncation : {4.0, 5.0, 6.0, 8.0}) {
      TsdfOptions options = PixelVoxels();
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
      EXPECT_LT(std::abs(deviation.mean), 0.02) << truncation;  // measured 0.0057, with normals 0.0039
      EXPECT_LT(deviation.rms, 0.02) << truncation;             // measured 0.0068
      EXPECT_LT(deviation.worst, 0.1) << truncation;            // measured 0.036
      bias = std::max(bias, std::abs(deviation.mean));
      worst = std::max(worst, deviation.worst);
      const MeshTopology topology = TopologyOf(mesh);
      EXPECT_EQ(topology.num_boundary_edges, 0);
      EXPECT_EQ(topology.num_bad_edges, 0);
      EXPECT_EQ(topology.num_components, 1);
      EXPECT_EQ(topology.euler_characteristic, 2);
      EXPECT_NEAR(topology.area, 4 * kPi * 0.64, 0.01 * 4 * kPi * 0.64);
      EXPECT_NEAR(topology.volume, 4 * kPi / 3 * 0.512, 0.005 * 4 * kPi / 3 * 0.512);
    }
  }
  const char* on = NameOf(GetParam());
  ExpectWithin(numerics::kTsdf, "bias, truncation 4 to 8 voxels [voxels]", on, bias, 0.1);
  ExpectWithin(numerics::kTsdf, "farthest vertex, truncation 4 to 8 voxels [voxels]", on, worst, 0.1);
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
    TsdfOptions options = PixelVoxels();
    options.truncation_voxels = truncation;
    options.backend = GetParam();
    TsdfSummary summary;
    const TriangleMesh mesh = Fuse(views, options, &summary);
    EXPECT_EQ(summary.backend, GetParam());
    const Rigid3 box_from_object = object_from_box.Inverse();
    const Deviation deviation = DeviationOf(mesh, summary.voxel_size, [&](const Eigen::Vector3d& x) {
      return BoxDistance(box_from_object * x, half);
    });
    EXPECT_LT(std::abs(deviation.mean), 0.05) << truncation;  // measured 0.033: edges, hidden corners
    EXPECT_LT(deviation.rms, 0.15) << truncation;             // measured 0.10
    const MeshTopology topology = TopologyOf(mesh);
    EXPECT_EQ(topology.num_boundary_edges, 0);
    EXPECT_EQ(topology.num_bad_edges, 0);
    EXPECT_EQ(topology.num_components, 1);
    EXPECT_EQ(topology.euler_characteristic, 2);
    const double area = 8 * (half.x() * half.y() + half.y() * half.z() + half.z() * half.x());
    EXPECT_NEAR(topology.area, area, 0.01 * area);
  }
}

// Both backends compute the same field but for rounding.
TEST_P(TsdfOnBackend, AgreesWithTheCpu) {
  AnalyticViewOptions view_options;
  view_options.num_views = 30;
  view_options.with_mask = true;
  view_options.with_colors = true;
  Rigid3 aside;
  aside.translation = {0.5, 0.4, 0.3};
  const std::vector<DepthView> views =
      AnalyticViews({SphereShape(0.7), BoxShape({0.3, 0.3, 0.3}, aside)}, view_options);
  const DepthViewList source(views);
  TsdfOptions options = PixelVoxels();
  Reporter silent;
  options.backend = TsdfBackend::kCpu;
  TsdfFusion reference(source, options, silent);
  const TsdfVolume expected = reference.Fuse();
  options.backend = GetParam();
  TsdfFusion fusion(source, options, silent);
  const TsdfVolume volume = fusion.Fuse();
  EXPECT_EQ(fusion.summary().backend, GetParam());
  ASSERT_EQ(volume.distances.size(), expected.distances.size());
  size_t num_different = 0;
  for (size_t i = 0; i < volume.distances.size(); ++i) {
    // Where a voxel falls on the border of a pixel, rounding decides which one it is.
    const bool is_same =
        std::abs(volume.weights[i] - expected.weights[i]) < 1e-3F * (1 + expected.weights[i]) &&
        (expected.weights[i] == 0 || std::abs(volume.distances[i] - expected.distances[i]) < 1e-3F);
    if (!is_same) ++num_different;
  }
  EXPECT_LT(static_cast<double>(num_different), 1e-3 * static_cast<double>(volume.distances.size()));
}

std::string BackendName(const testing::TestParamInfo<TsdfBackend>& info) {
  return info.param == TsdfBackend::kCpu ? "Cpu" : "Cuda";
}
INSTANTIATE_TEST_SUITE_P(Backends, TsdfOnBackend, testing::Values(TsdfBackend::kCpu, TsdfBackend::kCuda),
                         BackendName);

TsdfOptions CpuOptions(int num_threads = 2) {
  TsdfOptions options = PixelVoxels();
  options.backend = TsdfBackend::kCpu;
  options.num_threads = num_threads;
  return options;
}

TsdfOptions OptionsOf(TsdfBackend backend) {
  TsdfOptions options = CpuOptions();
  options.backend = backend;
  return options;
}

AnalyticViewOptions SmallViews() {
  AnalyticViewOptions options;
  options.num_views = 24;
  options.width = 80;
  options.height = 70;
  options.focal = 150;
  options.principal_point = {41.3, 33.9};
  options.with_colors = true;
  return options;
}

double SphereDistance(const Eigen::Vector3d& x) { return x.norm() - 0.8; }

TEST(Tsdf, SameBitsForAnyNumberOfThreads) {
  AnalyticViewOptions view_options = SmallViews();
  view_options.with_mask = true;
  const std::vector<DepthView> views = AnalyticViews({SphereShape(0.8)}, view_options);
  const TriangleMesh one = Fuse(views, CpuOptions(1));
  ASSERT_GT(one.triangles.size(), 1000u);
  for (const int num_threads : {2, 3, 5}) {
    const TriangleMesh many = Fuse(views, CpuOptions(num_threads));
    EXPECT_EQ(one.vertices, many.vertices);
    EXPECT_EQ(one.normals, many.normals);
    EXPECT_EQ(one.colors, many.colors);
    EXPECT_EQ(one.triangles, many.triangles);
  }
}

// Views that do not fit into memory together are read again, in batches: the same result.
TEST(Tsdf, SameBitsInBatches) {
  const std::vector<DepthView> views = AnalyticViews({SphereShape(0.8)}, SmallViews());
  const TriangleMesh whole = Fuse(views, CpuOptions());
  TsdfOptions options = CpuOptions();
  // 24 views of at most 80 x 70 pixels of 20 bytes are up to 2.6 MB, of which half this may be used.
  options.max_memory_gib = 0.0035;
  options.voxel_size = 0.04;
  TsdfOptions roomy = options;
  roomy.max_memory_gib = 1;
  const TriangleMesh batches = Fuse(views, options);
  const TriangleMesh at_once = Fuse(views, roomy);
  EXPECT_EQ(batches.vertices, at_once.vertices);
  EXPECT_EQ(batches.colors, at_once.colors);
  EXPECT_EQ(batches.triangles, at_once.triangles);
}

// Many threads prepare many views at once only where these fit.
TEST(Tsdf, ThreadsTakeNoMoreMemoryThanThereIs) {
  const std::vector<DepthView> views = AnalyticViews({SphereShape(0.8)}, SmallViews());
  TsdfOptions options = CpuOptions();
  options.max_memory_gib = 0.0035;
  options.voxel_size = 0.04;
  std::vector<int64_t> predicted;
  for (const int num_threads : {1, 16}) {
    options.num_threads = num_threads;
    TsdfSummary summary;
    Fuse(views, options, &summary);
    predicted.push_back(static_cast<int64_t>(summary.predicted_bytes));
  }
  EXPECT_EQ(predicted[1], predicted[0]);
  EXPECT_LT(static_cast<double>(predicted[0]), 0.0035 * 1024 * 1024 * 1024);
}

TEST_P(TsdfOnBackend, ScaleAndPlaceDoNotMatter) {
  const TsdfOptions tsdf = OptionsOf(GetParam());
  AnalyticViewOptions view_options = SmallViews();
  const TriangleMesh reference = Fuse(AnalyticViews({SphereShape(0.8)}, view_options), tsdf);
  for (const double scale : {1e-3, 1e3}) {
    view_options.scale = scale;
    const TriangleMesh mesh = Fuse(AnalyticViews({SphereShape(0.8)}, view_options), tsdf);
    ASSERT_EQ(mesh.vertices.size(), reference.vertices.size());
    double worst = 0;
    double sum = 0;
    for (size_t i = 0; i < mesh.vertices.size(); ++i) {
      const Eigen::Vector3d x = mesh.vertices[i].cast<double>() / scale;
      const double distance = (x - reference.vertices[i].cast<double>()).norm();
      worst = std::max(worst, distance);
      sum += distance * distance;
    }
    ExpectWithin(
        numerics::kScaleAndPlace,
        std::string("mesh, RMS of its vertices over its size, lengths x ") + (scale < 1 ? "1e-3" : "1e3"),
        NameOf(GetParam()), std::sqrt(sum / static_cast<double>(mesh.vertices.size())) / 1.6, 1e-5);
    // Where a voxel falls on the border of two pixels, rounding decides which plane it meets:
    // measured 8.5e-5, 0.4 % of a voxel.
    EXPECT_LT(worst, 2e-4) << scale;
  }
  // Powers of two change no rounding, so they change nothing: no constant has a unit.
  for (const double scale : {0x1p-10, 0x1p10}) {
    view_options.scale = scale;
    const TriangleMesh mesh = Fuse(AnalyticViews({SphereShape(0.8)}, view_options), tsdf);
    ASSERT_EQ(mesh.vertices.size(), reference.vertices.size());
    EXPECT_EQ(mesh.triangles, reference.triangles);
    double worst = 0;
    for (size_t i = 0; i < mesh.vertices.size(); ++i) {
      const Eigen::Vector3d x = mesh.vertices[i].cast<double>() / scale;
      worst = std::max(worst, (x - reference.vertices[i].cast<double>()).norm());
    }
    EXPECT_EQ(worst, 0) << scale;
  }
  view_options.scale = 1;
  view_options.middle = {100, -200, 50};
  Shape sphere = SphereShape(0.8);
  sphere.frame_from_shape.translation = view_options.middle;
  const TriangleMesh moved = Fuse(AnalyticViews({sphere}, view_options), tsdf);
  TsdfSummary summary;
  Fuse(AnalyticViews({sphere}, view_options), tsdf, &summary);
  const Deviation deviation = DeviationOf(moved, summary.voxel_size, [&](const Eigen::Vector3d& x) {
    return SphereDistance(x - view_options.middle);
  });
  EXPECT_LT(std::abs(deviation.mean), 0.02);
  EXPECT_EQ(TopologyOf(moved).euler_characteristic, 2);
}

// A million diameters from the frame's origin. A mesh's vertices are float, which are 6 % of the diameter
// apart out there, so the field itself is compared: where its voxels are, and what they hold.
TEST_P(TsdfOnBackend, FieldsFarFromTheOriginAreTheSame) {
  const auto field = [](const Eigen::Vector3d& middle) {
    AnalyticViewOptions view_options = SmallViews();
    view_options.middle = middle;
    Shape sphere = SphereShape(0.8);
    sphere.frame_from_shape.translation = middle;
    const DepthViewList views(AnalyticViews({sphere}, view_options));
    Reporter silent;
    TsdfFusion fusion(views, OptionsOf(GetParam()), silent);
    return fusion.Fuse();
  };
  const auto deviation = [&](const Eigen::Vector3d& middle) {
    TsdfVolume volume = field(middle);
    volume.origin -= middle;
    const TriangleMesh mesh = MarchingCubes(volume, 2);
    EXPECT_EQ(TopologyOf(mesh).euler_characteristic, 2);
    return DeviationOf(mesh, 1.6, SphereDistance);
  };
  const Deviation here = deviation(Eigen::Vector3d::Zero());
  const Deviation far = deviation(1e6 * Eigen::Vector3d(0.6, -0.7, 0.4));
  ExpectWithin(numerics::kScaleAndPlace,
               "field of a sphere moved by 1e6 sizes: change of its bias and RMS error over its size",
               NameOf(GetParam()), std::max(std::abs(far.mean - here.mean), std::abs(far.rms - here.rms)),
               1e-5);
}

TEST(Tsdf, ColorsAreThoseOfTheSurface) {
  AnalyticViewOptions view_options = SmallViews();
  const TriangleMesh mesh = Fuse(AnalyticViews({SphereShape(0.8)}, view_options), CpuOptions());
  ASSERT_EQ(mesh.colors.size(), mesh.vertices.size());
  double worst = 0;
  for (size_t i = 0; i < mesh.vertices.size(); ++i) {
    const Eigen::Array3d expected = AnalyticColor(mesh.vertices[i].cast<double>().normalized());
    worst = std::max(worst, (mesh.colors[i].cast<double>().array() - expected).abs().maxCoeff());
  }
  EXPECT_LT(worst, 5);  // a pixel spans up to 2.5 grey levels
}

// The value at column 0, row 0 of COLMAP's maps belongs to image position (0, 0).
TEST(Tsdf, FirstPositionIsHonoured) {
  AnalyticViewOptions view_options = SmallViews();
  view_options.first_position = kColmapMapPosition;
  std::vector<DepthView> views = AnalyticViews({SphereShape(0.8)}, view_options);
  TsdfSummary summary;
  const TriangleMesh right_mesh = Fuse(views, CpuOptions(), &summary);
  const Deviation right = DeviationOf(right_mesh, summary.voxel_size, SphereDistance);
  for (DepthView& view : views) view.first_position = {0.5, 0.5};
  const TriangleMesh wrong_mesh = Fuse(views, CpuOptions(), &summary);
  const Deviation wrong = DeviationOf(wrong_mesh, summary.voxel_size, SphereDistance);
  EXPECT_LT(right.rms, 0.03);
  EXPECT_GT(wrong.rms, 0.1);
}

// A depth map that claims a surface where a mask of another view sees through.
TEST(Tsdf, EmptySpaceOutsideTheMaskIsCarved) {
  AnalyticViewOptions view_options = SmallViews();
  view_options.with_mask = true;
  view_options.focal = 100;  // all views see the space around the sphere
  std::vector<DepthView> views = AnalyticViews({SphereShape(0.8)}, view_options);
  // A patch floating in front of the sphere in one view.
  DepthView& bad = views[5];
  for (int y = 25; y < 45; ++y) {
    for (int x = 30; x < 50; ++x) bad.depths[static_cast<size_t>(y) * bad.camera.width + x] = 2.7F;
  }
  const auto num_floating = [](const TriangleMesh& mesh) {
    return std::count_if(mesh.vertices.begin(), mesh.vertices.end(),
                         [](const Eigen::Vector3f& x) { return x.norm() > 1; });
  };
  TsdfOptions options = CpuOptions();
  EXPECT_EQ(num_floating(Fuse(views, options)), 0);
  options.carve = false;
  EXPECT_GT(num_floating(Fuse(views, options)), 100);
}

// What lies outside a mask does not count, whatever its depth.
TEST(Tsdf, DepthsOutsideTheMaskDoNotCount) {
  AnalyticViewOptions view_options = SmallViews();
  view_options.with_mask = true;
  std::vector<DepthView> views = AnalyticViews({SphereShape(0.8)}, view_options);
  for (DepthView& view : views) {
    for (size_t i = 0; i < view.depths.size(); ++i) {
      if (view.mask.pixels[i] == 0) view.depths[i] = 4.5F;
    }
  }
  const TriangleMesh mesh = Fuse(views, CpuOptions());
  EXPECT_EQ(TopologyOf(mesh).num_components, 1);
  EXPECT_EQ(TopologyOf(mesh).euler_characteristic, 2);
}

// NaN, infinities, negative and absurd depths are as good as none.
TEST(TsdfBadInput, DepthsThatAreNoDepths) {
  AnalyticViewOptions view_options = SmallViews();
  view_options.with_normals = true;
  std::vector<DepthView> views = AnalyticViews({SphereShape(0.8)}, view_options);
  constexpr float kInfinite = std::numeric_limits<float>::infinity();
  const float bad[] = {std::numeric_limits<float>::quiet_NaN(), kInfinite, -kInfinite, -1, 0, 1e38F, 1e-40F};
  RandomNumbers random(3);
  for (DepthView& view : views) {
    for (size_t i = 0; i < view.depths.size(); ++i) {
      if (random.Uniform() < 0.05) view.depths[i] = bad[random.Index(7)];
      if (random.Uniform() < 0.05) view.normals[random.Index(view.normals.size())] = bad[random.Index(7)];
    }
  }
  TsdfSummary summary;
  const TriangleMesh mesh = Fuse(views, CpuOptions(), &summary);
  for (const Eigen::Vector3f& vertex : mesh.vertices) ASSERT_TRUE(vertex.allFinite());
  const Deviation deviation = DeviationOf(mesh, summary.voxel_size, SphereDistance);
  EXPECT_LT(std::abs(deviation.mean), 0.05);
  EXPECT_LT(deviation.rms, 0.1);
}

// One depth of a kilometre neither changes the grid nor asks for memory.
TEST(TsdfBadInput, OneOutlierDepth) {
  std::vector<DepthView> views = AnalyticViews({SphereShape(0.8)}, SmallViews());
  TsdfSummary clean;
  Fuse(views, CpuOptions(), &clean);
  DepthView& view = views[3];
  for (int i = 0; i < 3; ++i) view.depths[static_cast<size_t>(30 + i) * view.camera.width + 40] = 1000;
  TsdfSummary summary;
  const TriangleMesh mesh = Fuse(views, CpuOptions(), &summary);
  EXPECT_NEAR(summary.voxel_size, clean.voxel_size, 1e-3 * clean.voxel_size);
  EXPECT_LT(summary.num_blocks, clean.num_blocks + 20);
  EXPECT_EQ(TopologyOf(mesh).num_components, 1);
}

TEST(TsdfBadInput, MemoryIsBoundedBeforeItIsAllocated) {
  const std::vector<DepthView> views = AnalyticViews({SphereShape(0.8)}, SmallViews());
  TsdfOptions options = CpuOptions();
  options.voxel_size = 1e-4;
  options.max_memory_gib = 0.05;
  const ScopedAllocationLimit limit(size_t{64} << 20U);
  ExpectUserError([&] { Fuse(views, options); }, {"max_memory_gib", "voxel_size"});
  options.voxel_size = 1e-12;
  ExpectUserError([&] { Fuse(views, options); }, {"voxel_size"});
}

TEST(TsdfBadInput, MemoryThatIsMissingIsStatedWithWhatHelps) {
  const std::vector<DepthView> views = AnalyticViews({SphereShape(0.8)}, SmallViews());
  TsdfOptions options = CpuOptions();
  options.voxel_size = 0.01;
  options.max_memory_gib = 0.01;
  std::string message;
  const auto number_after = [&](const std::string& words) {
    const size_t at = message.find(words);
    return at == std::string::npos ? -1 : std::stod(message.substr(at + words.size()));
  };
  // Coarse voxels have a thicker shell of blocks than the square of the resolution says: a few steps.
  int refusals = 0;
  for (bool fits = false; !fits && refusals < 5;) {
    try {
      Fuse(views, options);
      fits = true;
    } catch (const UserError& error) {
      message = error.what();
      ++refusals;
      EXPECT_NEAR(number_after("voxels of "), options.voxel_size, 1e-5) << message;
      EXPECT_EQ(number_after("max_memory_gib is "), 0.01) << message;
      // Two floats a voxel of 512, the key and the extraction's share for each block; and two megabytes of
      // views.
      const double needed = number_after(" needs ") * 1024 * 1024 * 1024;
      const double blocks = number_after("of memory or more (");
      EXPECT_NEAR(needed, blocks * (2 * 4 * 512 + 24 + 5200) + 2e6, 0.5e6) << message;
      const double advised = number_after("Set voxel_size to ");
      EXPECT_GT(advised, 1.04 * options.voxel_size) << message;
      EXPECT_LT(advised, 1.5 * options.voxel_size) << message;
      options.voxel_size = advised;
    }
  }
  EXPECT_GT(refusals, 0);
  EXPECT_LT(refusals, 5);
}

// A photo whose mask is empty: also where the object would lie across its corner.
TEST(TsdfBadInput, ViewThatShowsNothing) {
  const std::vector<DepthView> views = AnalyticViews({SphereShape(0.8)}, SmallViews());
  const TriangleMesh expected = Fuse(views, CpuOptions());
  AnalyticViewOptions corner = SmallViews();
  corner.num_views = 1;
  corner.principal_point.setZero();
  for (const bool has_mask : {false, true}) {
    corner.with_mask = has_mask;
    std::vector<DepthView> more = views;
    more.push_back(AnalyticViews({SphereShape(0.8)}, corner)[0]);
    std::fill(more.back().depths.begin(), more.back().depths.end(), 0.0F);
    if (has_mask) std::fill(more.back().mask.pixels.begin(), more.back().mask.pixels.end(), uint8_t{0});
    const TriangleMesh mesh = Fuse(more, CpuOptions());
    EXPECT_EQ(mesh.vertices, expected.vertices) << has_mask;
    EXPECT_EQ(mesh.triangles, expected.triangles) << has_mask;
  }
}

TEST(TsdfBadInput, NothingToFuse) {
  ExpectUserError([] { Fuse({}, CpuOptions()); }, {"no surface"});
  std::vector<DepthView> views = AnalyticViews({SphereShape(0.8)}, SmallViews());
  for (DepthView& view : views) std::fill(view.depths.begin(), view.depths.end(), 0.0F);
  ExpectUserError([&] { Fuse(views, CpuOptions()); }, {"no surface"});
}

TEST(TsdfBadInput, SizesAndCamerasThatDoNotFit) {
  const std::vector<DepthView> good = AnalyticViews({SphereShape(0.8)}, SmallViews());
  const auto expect_refused = [&](const auto& damage) {
    std::vector<DepthView> views = good;
    damage(&views[1]);
    ExpectUserError([&] { Fuse(views, CpuOptions()); }, {"cannot be fused"});
  };
  expect_refused([](DepthView* view) { view->depths.pop_back(); });
  expect_refused([](DepthView* view) { view->normals.resize(5); });
  expect_refused([](DepthView* view) { view->colors.channels = 1; });
  expect_refused([](DepthView* view) { view->mask = {3, 3, 3, std::vector<uint8_t>(27)}; });
  expect_refused([](DepthView* view) { view->camera.fx = 0; });
  expect_refused([](DepthView* view) { view->camera.cx = std::numeric_limits<double>::quiet_NaN(); });
  expect_refused([](DepthView* view) { view->camera.cam_from_object.rotation.coeffs().setZero(); });
  TsdfOptions options = PixelVoxels();
  options.truncation_voxels = 1;
  ExpectUserError([&] { Fuse(good, options); }, {"truncation_voxels"});
}

TEST(Tsdf, DistanceTransformIsExact) {
  RandomNumbers random(4);
  for (const double density : {0.0, 0.01, 0.3}) {
    constexpr int kWidth = 37;
    constexpr int kHeight = 23;
    std::vector<uint8_t> set(kWidth * kHeight);
    for (uint8_t& value : set) value = random.Uniform() < density ? 1 : 0;
    const std::vector<float> distances = DistanceToSet(set, kWidth, kHeight);
    for (int i = 0; i < kWidth * kHeight; ++i) {
      double nearest = 1e9;
      for (int j = 0; j < kWidth * kHeight; ++j) {
        if (set[j] != 0)
          nearest = std::min(nearest, std::hypot(i % kWidth - j % kWidth, i / kWidth - j / kWidth));
      }
      if (density == 0) {
        EXPECT_GT(distances[i], 1e8F);
      } else {
        EXPECT_NEAR(distances[i], nearest, 1e-4);
      }
    }
  }
}

}  // namespace
}  // namespace s2gs
