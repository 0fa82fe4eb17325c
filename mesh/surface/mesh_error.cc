#include "mesh/surface/mesh_error.h"

#include <algorithm>
#include <cmath>
#include <flann/flann.hpp>
#include <limits>
#include <numeric>

#include "mesh/surface/triangle_area.h"
#include "s2gs/core/rng.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {
namespace {

using Eigen::Vector3d;

// Streams of random numbers, so that no two samplings of a comparison are correlated.
constexpr int64_t kSamplesAtATime = 2048;  // of a thread; each is short work
constexpr uint64_t kTruthStream = 1;
constexpr uint64_t kOccluderStream = 2;

// The pixel of a point, or -1 when it is outside the image or behind the camera.
int64_t PixelIndex(const ObjectView& view, const Vector3d& x_in_cam) {
  if (!(x_in_cam.z() > 0)) return -1;
  const double u = std::floor(x_in_cam.x() / x_in_cam.z() * view.fx + view.cx);
  const double v = std::floor(x_in_cam.y() / x_in_cam.z() * view.fy + view.cy);
  if (!(u >= 0 && u < view.width && v >= 0 && v < view.height)) return -1;
  return static_cast<int64_t>(v) * view.width + static_cast<int64_t>(u);
}

void LowerDepths(const ObjectView& view, const std::vector<Vector3d>& points, std::vector<double>* depths) {
  const Eigen::Matrix3d rotation = view.cam_from_object.rotation.toRotationMatrix();
  for (const Vector3d& point : points) {
    const Vector3d x_in_cam = rotation * point + view.cam_from_object.translation;
    const int64_t pixel = PixelIndex(view, x_in_cam);
    if (pixel >= 0) (*depths)[pixel] = std::min((*depths)[pixel], x_in_cam.z());
  }
}

void CountUnhidden(const ObjectView& view, const std::vector<Vector3d>& points,
                   const std::vector<double>& depths, double depth_tolerance, std::vector<int>* counts) {
  const Eigen::Matrix3d rotation = view.cam_from_object.rotation.toRotationMatrix();
  for (size_t i = 0; i < points.size(); ++i) {
    const Vector3d x_in_cam = rotation * points[i] + view.cam_from_object.translation;
    const int64_t pixel = PixelIndex(view, x_in_cam);
    if (pixel >= 0 && x_in_cam.z() <= depths[pixel] + depth_tolerance) ++(*counts)[i];
  }
}

double Mean(const std::vector<double>& values) {
  return std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
}

double ShareBelow(const std::vector<double>& values, double threshold) {
  const auto count =
      std::count_if(values.begin(), values.end(), [&](double value) { return value < threshold; });
  return static_cast<double>(count) / static_cast<double>(values.size());
}

SurfaceErrors Summarise(const std::vector<double>& to_truth, const std::vector<double>& to_estimate,
                        const std::vector<double>& thresholds) {
  SurfaceErrors errors;
  errors.accuracy = Mean(to_truth);
  errors.completeness = Mean(to_estimate);
  errors.chamfer_l1 = (errors.accuracy + errors.completeness) / 2;
  for (const double threshold : thresholds) {
    FScore score;
    score.threshold = threshold;
    score.precision = ShareBelow(to_truth, threshold);
    score.recall = ShareBelow(to_estimate, threshold);
    const double sum = score.precision + score.recall;
    score.f_score = sum > 0 ? 2 * score.precision * score.recall / sum : 0;
    errors.f_scores.push_back(score);
  }
  return errors;
}

}  // namespace

SurfaceSamples SampleSurface(const TriangleMesh& mesh, int64_t count, uint64_t seed, uint64_t stream) {
  SurfaceSamples samples;
  std::vector<double> area_up_to(mesh.triangles.size());
  for (size_t i = 0; i < mesh.triangles.size(); ++i) {
    const double area = TriangleArea(mesh, mesh.triangles[i]);
    if (std::isfinite(area) && area > 0) {
      samples.area += area;
    } else {
      ++samples.num_unusable_triangles;
    }
    area_up_to[i] = samples.area;
  }
  if (!(samples.area > 0) || count <= 0) return samples;

  samples.points.resize(static_cast<size_t>(count));
  ParallelFor(count, 0, kSamplesAtATime, [&](int64_t i) {
    const Random4 bits = RandomBits(seed, stream, static_cast<uint64_t>(i));
    const double area = UnitDouble(bits.words[0], bits.words[1]) * samples.area;
    // The first triangle that ends beyond `area`; an unusable one ends where its predecessor does.
    auto found = std::upper_bound(area_up_to.begin(), area_up_to.end(), area);
    if (found == area_up_to.end())
      found = std::lower_bound(area_up_to.begin(), area_up_to.end(), samples.area);
    const Eigen::Matrix<uint32_t, 3, 1>& triangle = mesh.triangles[found - area_up_to.begin()];
    const double root = std::sqrt(UnitDouble(bits.words[2]));
    const double along = UnitDouble(bits.words[3]);
    samples.points[i] = (1 - root) * mesh.vertices[triangle[0]].cast<double>() +
                        root * (1 - along) * mesh.vertices[triangle[1]].cast<double>() +
                        root * along * mesh.vertices[triangle[2]].cast<double>();
  });
  return samples;
}

std::vector<double> NearestDistances(const std::vector<Vector3d>& queries,
                                     const std::vector<Vector3d>& points) {
  S2GS_INVARIANT(!points.empty());
  static_assert(sizeof(Vector3d) == 3 * sizeof(double), "FLANN gets the vectors as rows of a matrix");
  std::vector<double> distances(queries.size());
  if (queries.empty()) return distances;
  // FLANN's matrices are never written to, although their pointer is not const.
  const flann::Matrix<double> rows(const_cast<double*>(points.front().data()), points.size(), 3);
  const flann::Matrix<double> query_rows(const_cast<double*>(queries.front().data()), queries.size(), 3);
  flann::KDTreeSingleIndex<flann::L2_3D<double>> tree(rows, flann::KDTreeSingleIndexParams(10));
  tree.buildIndex();

  std::vector<size_t> indices(queries.size());
  flann::Matrix<size_t> index_rows(indices.data(), queries.size(), 1);
  flann::Matrix<double> distance_rows(distances.data(), queries.size(), 1);
  flann::SearchParams exact(flann::FLANN_CHECKS_UNLIMITED);
  exact.cores = NumThreadsOf(0);
  tree.knnSearch(query_rows, index_rows, distance_rows, 1, exact);
  for (double& squared : distances) squared = std::sqrt(squared);
  return distances;
}

std::vector<TriangleCorners> TrianglesInside(const TriangleMesh& mesh, const Sim3& region_from_mesh,
                                             const CropRegion& region) {
  std::vector<TriangleCorners> inside;
  for (const Triangle& triangle : mesh.triangles) {
    const double area = TriangleArea(mesh, triangle);
    if (!(std::isfinite(area) && area > 0)) continue;
    TriangleCorners corners;
    Eigen::AlignedBox3d box;
    bool is_on_side = !region.plane.has_value();
    for (int i = 0; i < 3; ++i) {
      corners[i] = region_from_mesh * mesh.vertices[triangle[i]].cast<double>();
      box.extend(corners[i]);
      is_on_side = is_on_side || region.plane->signedDistance(corners[i]) > 0;
    }
    if (is_on_side && (!region.box || region.box->intersects(box))) inside.push_back(corners);
  }
  return inside;
}

std::vector<int> CountViewsSeen(const std::vector<Vector3d>& points, const std::vector<Vector3d>& occluders,
                                const std::vector<ObjectView>& views, double depth_tolerance) {
  std::vector<int> counts(points.size());
  std::vector<std::vector<int>> counts_of_thread(NumThreadsOf(0));
  ParallelFor(static_cast<int64_t>(views.size()), 0, [&](int64_t i) {
    std::vector<int>& own_counts = counts_of_thread[LoopThread()];
    own_counts.resize(points.size());
    std::vector<double> depths(static_cast<size_t>(views[i].width) * views[i].height,
                               std::numeric_limits<double>::infinity());
    LowerDepths(views[i], points, &depths);
    LowerDepths(views[i], occluders, &depths);
    CountUnhidden(views[i], points, depths, depth_tolerance, &own_counts);
  });
  for (const std::vector<int>& own_counts : counts_of_thread) {
    for (size_t i = 0; i < own_counts.size(); ++i) counts[i] += own_counts[i];
  }
  return counts;
}

TruthSurface MakeTruthSurface(const TriangleMesh& truth, const TriangleMesh& occluder,
                              const std::vector<ObjectView>& views, const CropRegion& region,
                              const TruthSurfaceOptions& options) {
  const std::vector<Vector3d> samples =
      SampleSurface(truth, options.num_samples, options.seed, kTruthStream).points;
  std::vector<int> counts;
  if (!views.empty()) {
    Eigen::AlignedBox3d bounds;
    for (const Vector3d& x : samples) bounds.extend(x);
    const double diagonal = samples.empty() ? 0 : bounds.diagonal().norm();
    counts = CountViewsSeen(
        samples, SampleSurface(occluder, options.num_occluder_samples, options.seed, kOccluderStream).points,
        views, options.depth_tolerance_ratio * diagonal);
  }
  TruthSurface surface;
  surface.triangles = TrianglesInside(truth, Sim3(), region);
  int64_t num_seen = 0;
  for (size_t i = 0; i < samples.size(); ++i) {
    if (!region.Contains(samples[i])) continue;
    surface.points.push_back(samples[i]);
    if (!views.empty() && counts[i] < options.min_num_views) continue;
    if (num_seen++ < options.max_num_seen_points) surface.seen_points.push_back(samples[i]);
  }
  if (!surface.points.empty()) {
    surface.seen_share = static_cast<double>(num_seen) / static_cast<double>(surface.points.size());
  }
  return surface;
}

std::optional<SurfaceErrors> CompareSurfaces(const EstimatedSurface& estimate, const TruthSurface& truth,
                                             const std::vector<double>& thresholds) {
  if (estimate.points.empty() || estimate.triangles.empty()) return std::nullopt;
  if (truth.triangles.empty() || truth.seen_points.empty()) return std::nullopt;
  return Summarise(DistancesToTriangles(estimate.points, truth.triangles),
                   DistancesToTriangles(truth.seen_points, estimate.triangles), thresholds);
}

std::optional<SurfaceErrors> CompareSamples(const std::vector<Vector3d>& estimate, const TruthSurface& truth,
                                            const std::vector<double>& thresholds) {
  if (estimate.empty() || truth.points.empty() || truth.seen_points.empty()) return std::nullopt;
  return Summarise(NearestDistances(estimate, truth.points), NearestDistances(truth.seen_points, estimate),
                   thresholds);
}

std::vector<Vector3d> Crop(const std::vector<Vector3d>& points, const CropRegion& region) {
  std::vector<Vector3d> kept;
  std::copy_if(points.begin(), points.end(), std::back_inserter(kept),
               [&](const Vector3d& x) { return region.Contains(x); });
  return kept;
}

}  // namespace s2gs
