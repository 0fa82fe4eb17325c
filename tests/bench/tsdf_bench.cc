// Times the fusion of exact depth maps of a sphere of radius 1, and its error. Another program can read the
// same depth maps: `--write FOLDER` leaves them with their poses (tests/bench/tsdf_bench.py does).
//
//   tsdf_bench [--write FOLDER] [VIEWS [SIZE_PX [THREADS [cpu|cuda]]]]

#include <sys/resource.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iomanip>
#include <string>
#include <utility>
#include <vector>

#include "mesh/fusion/marching_cubes.h"
#include "mesh/fusion/tsdf.h"
#include "sfm_split/base/stopwatch.h"
#include "tests/mesh/fusion/analytic_views.h"

namespace s2gs {
namespace {

// Of all threads: what other work on the machine hardly changes.
double CpuSeconds() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  const auto seconds = [](const timeval& time) {
    return static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_usec);
  };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

double PeakMib() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_maxrss) / 1024;
}

void Write(const std::filesystem::path& folder, const std::vector<DepthView>& views, double voxel_size,
           double truncation) {
  std::filesystem::create_directories(folder);
  std::ofstream list(folder / "views.txt");
  list << std::setprecision(17) << views.size() << ' ' << voxel_size << ' ' << truncation << '\n';
  std::ofstream depths(folder / "depths.bin", std::ios::binary);
  std::ofstream colors(folder / "colors.bin", std::ios::binary);
  for (const DepthView& view : views) {
    const ObjectView& c = view.camera;
    list << c.width << ' ' << c.height << ' ' << c.fx << ' ' << c.fy << ' ' << c.cx << ' ' << c.cy;
    const Eigen::Matrix4d matrix = c.cam_from_object.Matrix();
    for (int i = 0; i < 16; ++i) list << ' ' << matrix(i / 4, i % 4);
    list << '\n';
    depths.write(reinterpret_cast<const char*>(view.depths.data()),
                 static_cast<std::streamsize>(view.depths.size() * sizeof(float)));
    colors.write(reinterpret_cast<const char*>(view.colors.pixels.data()),
                 static_cast<std::streamsize>(view.colors.pixels.size()));
  }
}

int Run(int num_views, int size_px, int num_threads, TsdfBackend backend, const char* folder) {
  AnalyticViewOptions view_options;
  view_options.num_views = num_views;
  view_options.width = size_px;
  view_options.height = size_px;
  view_options.focal = 1.3 * size_px;
  view_options.principal_point = {0.503 * size_px, 0.498 * size_px};
  view_options.with_colors = true;
  const DepthViewList views(AnalyticViews({SphereShape(1)}, view_options));
  Reporter silent;
  TsdfOptions options;
  options.num_threads = num_threads;
  options.backend = backend;
  const double before = PeakMib();
  std::vector<double> times;
  std::vector<double> cpu_times;
  TriangleMesh mesh;
  TsdfSummary summary;
  double prepare = 0;
  double fuse = 0;
  double extract = 0;
  for (int repeat = 0; repeat < 3; ++repeat) {
    mesh = {};
    const double start = SteadySeconds();
    const double cpu_start = CpuSeconds();
    TsdfFusion fusion(views, options, silent);
    const TsdfVolume volume = fusion.Fuse();
    const double fused = SteadySeconds();
    mesh = MarchingCubes(volume, num_threads);
    extract = SteadySeconds() - fused;
    fusion.ColorVertices(&mesh);
    times.push_back(SteadySeconds() - start);
    cpu_times.push_back(CpuSeconds() - cpu_start);
    summary = fusion.summary();
    prepare = summary.prepare_seconds;
    fuse = summary.fuse_seconds;
  }
  std::sort(times.begin(), times.end());
  std::sort(cpu_times.begin(), cpu_times.end());
  double sum = 0;
  double square = 0;
  double worst = 0;
  for (const Eigen::Vector3f& vertex : mesh.vertices) {
    const double d = (vertex.cast<double>().norm() - 1) / summary.voxel_size;
    sum += d;
    square += d * d;
    worst = std::max(worst, std::abs(d));
  }
  const auto count = static_cast<double>(mesh.vertices.size());
  std::printf(
      "s2gs (%s, %s): %.3f s (median of 3, CPU %.3f; last: prepare %.3f, fuse %.3f, extract %.3f, colours "
      "the rest), "
      "peak %.0f MiB over the %.0f MiB of the depth maps and images (predicted %.0f), voxel %.6g, "
      "%lld blocks, %zu vertices, error mean %.4f rms %.4f worst %.3f voxels\n",
      summary.backend == TsdfBackend::kCuda ? "GPU" : "CPU", summary.device.c_str(), times[1], cpu_times[1],
      prepare, fuse, extract, PeakMib() - before, before,
      static_cast<double>(summary.predicted_bytes) / 1024 / 1024, summary.voxel_size,
      static_cast<long long>(summary.num_blocks), mesh.vertices.size(), sum / count,
      std::sqrt(square / count), worst);
  if (folder != nullptr) {
    std::vector<DepthView> all;
    for (int i = 0; i < views.size(); ++i) all.push_back(*views.Load(i));
    Write(folder, all, summary.voxel_size, summary.truncation);
  }
  return EXIT_SUCCESS;
}

}  // namespace
}  // namespace s2gs

int main(int argc, char** argv) {
  const char* folder = nullptr;
  if (argc > 2 && std::strcmp(argv[1], "--write") == 0) {
    folder = argv[2];
    argv += 2;
    argc -= 2;
  }
  const int num_views = argc > 1 ? std::atoi(argv[1]) : 100;
  const int size_px = argc > 2 ? std::atoi(argv[2]) : 640;
  const int num_threads = argc > 3 ? std::atoi(argv[3]) : 2;
  const bool cuda = argc > 4 && std::strcmp(argv[4], "cuda") == 0;
  try {
    return s2gs::Run(num_views, size_px, num_threads,
                     cuda ? s2gs::TsdfBackend::kCuda : s2gs::TsdfBackend::kCpu, folder);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return EXIT_FAILURE;
  }
}
