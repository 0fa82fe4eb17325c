#include "mesh/fusion/tsdf.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <utility>

#include "mesh/fusion/marching_cubes.h"
#include "mesh/fusion/tsdf_cull.h"
#include "mesh/fusion/tsdf_integrate.h"
#include "mesh/fusion/tsdf_kernel_cpu.h"
#include "mesh/fusion/tsdf_view.h"
#include "mesh/fusion/tsdf_view_cache.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/base/stopwatch.h"

namespace s2gs {
namespace {

constexpr int kSamplesPerView = 4096;
constexpr double kOutlierQuantile = 0.005;
// How far around the box of all but the outermost samples depths still count, in its longest sides.
constexpr double kRegionMargin = 0.5;
constexpr double kGiB = 1024.0 * 1024.0 * 1024.0;
// Distance and weight of each voxel, and the block's key and its place in the table.
constexpr uint64_t kBlockBytes = 2 * sizeof(float) * kBlockVoxels + 24;
// What the extraction of the mesh takes besides: measured on spheres, where a block has 34 vertices.
constexpr uint64_t kExtractionBytesPerBlock = 5200;
// Colours come from views that see a vertex within this distance of their surface [voxels].
constexpr float kColorDistance = 1.5F;

}  // namespace

OptionCheck TsdfOptions::Check() const {
  const auto fault = [](const char* field, double value, const char* bound) {
    return OptionFault{field, fmt::format("{}", value), bound};
  };
  if (!(voxel_size >= 0) || !std::isfinite(voxel_size))
    return fault("voxel_size", voxel_size, "0 <= voxel_size");
  if (!(voxel_size_pixels > 0) || !(voxel_size_pixels <= 100)) {
    return fault("voxel_size_pixels", voxel_size_pixels, "0 < voxel_size_pixels <= 100");
  }
  if (max_resolution < 8 || max_resolution > 1'000'000) {
    return fault("max_resolution", max_resolution, "8 <= max_resolution <= 1000000");
  }
  if (!(truncation_voxels >= 2) || !(truncation_voxels <= 32)) {
    return fault("truncation_voxels", truncation_voxels, "2 <= truncation_voxels <= 32");
  }
  if (!(max_view_angle_deg > 0) || !(max_view_angle_deg <= 89)) {
    return fault("max_view_angle_deg", max_view_angle_deg, "0 < max_view_angle_deg <= 89");
  }
  if (!(mask_threshold > 0) || !(mask_threshold <= 1)) {
    return fault("mask_threshold", mask_threshold, "0 < mask_threshold <= 1");
  }
  if (!(max_memory_gib > 0) || !(max_memory_gib <= 1'048'576)) {
    return fault("max_memory_gib", max_memory_gib, "0 < max_memory_gib <= 1048576");
  }
  if (num_threads < 0 || num_threads > 4096)
    return fault("num_threads", num_threads, "0 <= num_threads <= 4096");
  return std::nullopt;
}

TsdfFusion::TsdfFusion(const DepthViewSource& source, const TsdfOptions& options, Reporter& reporter)
    : options_(options), reporter_(reporter) {
  if (const OptionCheck fault = options.Check()) {
    throw UserError("TsdfOptions: " + fault->field + " is " + fault->value + ", needed is " + fault->bound);
  }
  const double start = SteadySeconds();
  views_ = std::make_unique<TsdfViewCache>(source, options_, NumThreadsOf(options_.num_threads),
                                           static_cast<uint64_t>(options_.max_memory_gib * kGiB / 2));
  PlanGrid();
  FindBlocks();
  summary_.prepare_seconds = SteadySeconds() - start;
}

TsdfFusion::~TsdfFusion() = default;

void TsdfFusion::PlanGrid() {
  std::vector<TsdfSurfaceSample> samples;
  views_->ForEachBatch("read depth maps", reporter_, [&](const std::vector<const TsdfView*>& views) {
    std::vector<std::vector<TsdfSurfaceSample>> of_view(views.size());
    ParallelFor(static_cast<int64_t>(views.size()), options_.num_threads,
                [&](int64_t i) { of_view[i] = SampleTsdfSurface(*views[i], kSamplesPerView); });
    for (size_t i = 0; i < views.size(); ++i) {
      samples.insert(samples.end(), of_view[i].begin(), of_view[i].end());
      summary_.num_depths += views[i]->num_depths;
      summary_.num_views += views[i]->num_depths > 0 ? 1 : 0;
    }
  });
  if (samples.empty()) {
    throw UserError(
        "There is no surface to fuse: none of the depth maps has a depth that is positive, inside its mask, "
        "and "
        "seen at less than max_view_angle_deg. Check that depth maps and masks belong together");
  }
  const auto of_samples = [&](const auto& value) {
    std::vector<double> values(samples.size());
    std::transform(samples.begin(), samples.end(), values.begin(), value);
    return values;
  };
  const double depth = UpperMedian(of_samples([](const TsdfSurfaceSample& s) { return double{s.depth}; }));
  const double pixel = UpperMedian(of_samples([](const TsdfSurfaceSample& s) { return double{s.pixel}; }));
  Eigen::AlignedBox3d box;
  for (int axis = 0; axis < 3; ++axis) {
    const std::vector<double> places =
        of_samples([axis](const TsdfSurfaceSample& s) { return s.x_in_object[axis]; });
    // Of the nearest rank, where Quantile takes the one below, so that the box does not lean to one side.
    const auto last = static_cast<double>(places.size() - 1);
    const auto nearest = [&](double share) {
      return Quantile(places, (std::round(share * last) + 0.5) / std::max(last, 1.0));
    };
    box.min()[axis] = nearest(kOutlierQuantile);
    box.max()[axis] = nearest(1 - kOutlierQuantile);
  }
  const double longest = std::max(box.sizes().maxCoeff(), 8 * pixel);
  double voxel = options_.voxel_size;
  if (voxel == 0) voxel = std::max(options_.voxel_size_pixels * pixel, longest / options_.max_resolution);
  summary_.voxel_size = voxel;
  summary_.truncation = options_.truncation_voxels * voxel;
  region_ = box;
  region_.min().array() -= kRegionMargin * longest;
  region_.max().array() += kRegionMargin * longest;
  origin_ = box.center();
  if (region_.sizes().maxCoeff() / voxel > double{kBlockSide} * TsdfBlockIndex::kMaxCoordinate) {
    throw UserError(fmt::format(
        "A voxel_size of {:.3g} is too small for depth maps whose pixels are {:.3g} wide on the surface. "
        "Choose one near that, or 0",
        voxel, pixel));
  }
  voxel_params_ = {static_cast<float>(1 / voxel), static_cast<float>(options_.truncation_voxels),
                   static_cast<float>(depth * depth)};
}

uint64_t TsdfFusion::BytesNeeded(uint64_t num_blocks) const {
  return views_->peak_bytes() + num_blocks * (kBlockBytes + kExtractionBytesPerBlock);
}

void TsdfFusion::FailMemory(uint64_t num_blocks) const {
  const double needed = static_cast<double>(BytesNeeded(num_blocks)) / kGiB;
  const auto for_views = static_cast<double>(views_->peak_bytes()) / kGiB;
  // The surface's blocks grow with the square of the resolution.
  const double factor = std::sqrt((needed - for_views) / std::max(options_.max_memory_gib - for_views, 1e-9));
  throw UserError(fmt::format(
      "Fusing with voxels of {:.4g} needs {:.3g} GiB of memory or more ({} blocks), and "
      "max_memory_gib is {:.3g}. Set voxel_size to {:.3g} or more, or allow more memory",
      summary_.voxel_size, needed, num_blocks, options_.max_memory_gib, 1.05 * factor * summary_.voxel_size));
}

void TsdfFusion::FindBlocks() {
  const double max_bytes = options_.max_memory_gib * kGiB;
  const auto max_blocks =
      static_cast<uint64_t>(std::max(0.0, max_bytes - static_cast<double>(views_->peak_bytes())) /
                            static_cast<double>(kBlockBytes + kExtractionBytesPerBlock));
  TsdfBlockRequest request;
  request.origin = origin_;
  request.voxel_size = summary_.voxel_size;
  request.truncation_voxels = options_.truncation_voxels;
  request.region = region_;
  request.max_blocks = max_blocks;
  std::vector<uint64_t> keys;
  views_->ForEachBatch("find surface", reporter_, [&](const std::vector<const TsdfView*>& views) {
    const size_t group = 2 * static_cast<size_t>(NumThreadsOf(options_.num_threads));
    for (size_t begin = 0; begin < views.size(); begin += group) {
      const size_t count = std::min(group, views.size() - begin);
      std::vector<std::vector<uint64_t>> of_view(count);
      std::vector<int64_t> outliers(count);
      ParallelFor(static_cast<int64_t>(count), options_.num_threads, [&](int64_t i) {
        of_view[i] = FindViewBlocks(*views[begin + static_cast<size_t>(i)], request, &outliers[i]);
      });
      for (size_t i = 0; i < count; ++i) {
        std::vector<uint64_t> merged;
        merged.reserve(keys.size() + of_view[i].size());
        std::set_union(keys.begin(), keys.end(), of_view[i].begin(), of_view[i].end(),
                       std::back_inserter(merged));
        keys = std::move(merged);
        summary_.num_outliers += outliers[i];
      }
      if (keys.size() > max_blocks) FailMemory(keys.size());
    }
  });
  summary_.num_blocks = static_cast<int64_t>(keys.size());
  summary_.predicted_bytes = BytesNeeded(keys.size());
  blocks_ = TsdfBlockIndex(std::move(keys));
}

TsdfVolume TsdfFusion::Fuse() {
  const double start = SteadySeconds();
  TsdfVolume volume;
  volume.voxel_size = summary_.voxel_size;
  volume.truncation = summary_.truncation;
  volume.origin = origin_;
  volume.blocks = blocks_;
  const size_t num_voxels = static_cast<size_t>(blocks_.size()) * kBlockVoxels;
  volume.distances.resize(num_voxels);
  volume.weights.resize(num_voxels);
  std::unique_ptr<TsdfIntegrator> integrator;
  if (options_.backend != TsdfBackend::kCpu) {
    integrator = MakeCudaIntegrator(&volume);
    if (integrator == nullptr && options_.backend == TsdfBackend::kCuda) {
      throw UserError("No GPU can be used by this program (`s2gs --version` says why). Use the CPU");
    }
  }
  if (integrator == nullptr) integrator = MakeCpuIntegrator(NumThreadsOf(options_.num_threads), &volume);
  views_->ForEachBatch("fuse depth maps", reporter_, [&](const std::vector<const TsdfView*>& views) {
    integrator->Add(views, voxel_params_);
  });
  integrator->Finish();
  summary_.backend = integrator->backend();
  summary_.device = integrator->device();
  summary_.fuse_seconds = SteadySeconds() - start;
  return volume;
}

// Neighbours in the mesh are near each other in space, too: they are culled together.
void TsdfFusion::AddColors(const std::vector<const TsdfView*>& views,
                           const std::vector<TsdfViewParams>& params,
                           const std::vector<TsdfDepthTiles>& tiles, const Eigen::Vector3f* vertices,
                           int size, Eigen::Array4f* sums) const {
  const TsdfCpuKernel& kernel = BestTsdfCpuKernel();
  std::array<Eigen::Vector3d, kPointGroup> points;  // in the grid [voxels]
  Eigen::AlignedBox3d box;
  for (int i = 0; i < kPointGroup; ++i) {
    points[i] = (vertices[std::min(i, size - 1)].cast<double>() - origin_) / summary_.voxel_size;
    box.extend(points[i]);
  }
  alignas(64) float from_middle[3][kPointGroup];  // small: singles suffice
  for (int i = 0; i < kPointGroup; ++i) {
    for (int axis = 0; axis < 3; ++axis) {
      from_middle[axis][i] = static_cast<float>(points[i][axis] - box.center()[axis]);
    }
  }
  const auto radius = static_cast<float>(0.505 * box.diagonal().norm() * summary_.voxel_size);
  for (size_t v = 0; v < views.size(); ++v) {
    if (views[v]->colors.empty()) continue;
    const Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>> rotation(params[v].rotation);
    const Eigen::Map<const Eigen::Vector3d> translation(params[v].translation);
    const Eigen::Vector3f middle = (rotation * box.center() + translation).cast<float>();
    if (!MayMatter(params[v], tiles[v], middle.data(), radius)) continue;
    alignas(64) float x[3][kPointGroup];
    alignas(64) int32_t index[kPointGroup];
    alignas(64) float distance[kPointGroup];
    alignas(64) float weight[kPointGroup];
    for (int axis = 0; axis < 3; ++axis) {
      const Eigen::Vector3f row = rotation.row(axis).cast<float>();
      const float start = middle[axis];
#pragma omp simd
      for (int i = 0; i < kPointGroup; ++i) {
        x[axis][i] =
            start + row[0] * from_middle[0][i] + row[1] * from_middle[1][i] + row[2] * from_middle[2][i];
      }
    }
    kernel.sample_points(params[v], voxel_params_, x[0], x[1], x[2], index, distance, weight);
    for (int i = 0; i < size; ++i) {
      if (index[i] < kFirstPixel || !(weight[i] > 0) || std::abs(distance[i]) > kColorDistance) continue;
      const uint32_t rgb = views[v]->colors[index[i] - kFirstPixel];
      sums[i] +=
          weight[i] * Eigen::Array4f(static_cast<float>(rgb & 255U), static_cast<float>(rgb >> 8U & 255U),
                                     static_cast<float>(rgb >> 16U), 1);
    }
  }
}

void TsdfFusion::ColorVertices(TriangleMesh* mesh) const {
  if (!views_->has_colors() || mesh->vertices.empty()) return;
  const auto count = static_cast<int64_t>(mesh->vertices.size());
  std::vector<Eigen::Array4f> sums(mesh->vertices.size(), Eigen::Array4f::Zero());
  const int64_t num_groups = (count + kPointGroup - 1) / kPointGroup;
  views_->ForEachBatch("colour the mesh", reporter_, [&](const std::vector<const TsdfView*>& views) {
    std::vector<TsdfViewParams> params(views.size());
    std::vector<TsdfDepthTiles> tiles(views.size());
    ParallelFor(static_cast<int64_t>(views.size()), options_.num_threads, [&](int64_t i) {
      params[i] = ViewParams(*views[i], origin_, summary_.voxel_size);
      tiles[i] = MakeTsdfDepthTiles(*views[i], summary_.truncation, summary_.voxel_size);
    });
    ParallelFor(num_groups, options_.num_threads, 16, [&](int64_t group) {
      const int64_t first = group * kPointGroup;
      const auto size = static_cast<int>(std::min<int64_t>(kPointGroup, count - first));
      AddColors(views, params, tiles, &mesh->vertices[first], size, &sums[first]);
    });
  });
  mesh->colors.assign(mesh->vertices.size(), Eigen::Matrix<uint8_t, 3, 1>::Zero());
  for (int64_t i = 0; i < count; ++i) {
    if (!(sums[i][3] > 0)) continue;
    const Eigen::Array4f mean = sums[i] / sums[i][3] + 0.5F;
    for (int c = 0; c < 3; ++c) mesh->colors[i][c] = static_cast<uint8_t>(std::min(mean[c], 255.0F));
  }
}

TriangleMesh MeshFromDepthMaps(const DepthViewSource& source, const TsdfOptions& options, Reporter& reporter,
                               TsdfSummary* summary) {
  TsdfFusion fusion(source, options, reporter);
  TriangleMesh mesh = MarchingCubes(fusion.Fuse(), NumThreadsOf(options.num_threads));
  fusion.ColorVertices(&mesh);
  if (summary != nullptr) *summary = fusion.summary();
  return mesh;
}

}  // namespace s2gs
