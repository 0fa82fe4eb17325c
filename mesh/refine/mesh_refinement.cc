#include "mesh/refine/mesh_refinement.h"

#include <fmt/format.h>
#include <omp.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "mesh/refine/offset_field.h"
#include "mesh/refine/photo_consistency.h"
#include "mesh/refine/surface_relief.h"
#include "mesh/refine/vertex_visibility.h"
#include "mesh/surface/mesh_cleanup.h"
#include "mesh/surface/vertex_normals.h"
#include "s2gs/image/photos.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/stopwatch.h"

namespace s2gs {
namespace {

struct Pass {
  int level;      // of the photos' pyramids
  float step;     // between offsets [px of level 0]
  int max_steps;  // either way
  bool on_mesh;   // patches have the mesh's own relief, which is worth it once the mesh is about right.
};
constexpr std::array<Pass, 3> kPasses = {{{1, 2.0F, 3, false}, {0, 1.0F, 4, false}, {0, 0.5F, 4, true}}};

// With fewer, a part that one photo shows may well be there.
constexpr size_t kMinPhotosToDrop = 40;
// Of one vertex. Two photos agree by chance too often.
constexpr int kMinViews = 3;
// Around a vertex, as far as its patch reaches, the photo must show the mesh and nothing in front of it [px
// of the pyramid's level].
constexpr int kVisibilityMargin = kPatchSide / 2;
// Steeper views say neither where a surface is nor that it is there.
constexpr float kMinSeenCosine = 0.2F;
// How often curves are averaged with their neighbours'.
constexpr int kAverageRounds = 1;
// Peaks up to the first correlation count nothing, those from the second on fully: below are surfaces that
// reflect, that another part hides, or that are not where the mesh has them.
constexpr float kNoTrust = 0.4F;
constexpr float kFullTrust = 0.8F;
// How much a peak falls in a pixel of the pyramid's level at least. Shading without texture correlates at any
// depth, and its flat peaks lie where noise puts them (below 0.02; those of texture from 0.04 on).
constexpr float kLeastSharpness = 0.03F;
// Vertices at which the photos' agreement is measured.
constexpr size_t kMeasuredVertices = 20'000;
// A second peak of this share of the highest makes that doubtful.
constexpr float kRivalShare = 0.9F;
constexpr float kRivalTrust = 0.1F;
// Pull of each vertex towards where it is, beside 1 for a peak that falls by 1 in a pixel. Weak: the offset
// of what has texture holds for its plain surroundings.
constexpr double kPrior = 1e-5;
// Photos need not be finer than this share of the mesh's edges.
constexpr double kPixelPerEdge = 1.0 / 3;
constexpr int kMaxShrink = 16;
// What a photo takes with its coarser level.
constexpr double kPyramidBytesPerPixel = 1.25;
// Beyond the mesh's outline in a photo: room for patches [px].
constexpr double kCropMargin = 16;  // not below kMaxShrink
constexpr double kGiB = 1024.0 * 1024.0 * 1024.0;
constexpr int64_t kVerticesPerTurn = 16384;

struct Crop {
  int index = 0;  // of the photo, in the source
  ImagePart part;
};

// What of the photo shows the mesh; nothing when it is hardly any.
std::optional<Crop> FindCrop(const TriangleMesh& mesh, const ObjectView& view, int index) {
  Eigen::AlignedBox2d box;
  for (const Eigen::Vector3f& vertex : mesh.vertices) {
    const Eigen::Vector3d x = view.cam_from_object * vertex.cast<double>();
    if (!(x.z() > 0)) continue;
    box.extend(Eigen::Vector2d(view.fx * x.x() / x.z() + view.cx, view.fy * x.y() / x.z() + view.cy));
  }
  if (box.isEmpty()) return std::nullopt;
  const auto range = [](double low, double high, int size, int* first, int* count) {
    const double begin = std::clamp(std::floor(low - kCropMargin), 0.0, static_cast<double>(size));
    const double end = std::clamp(std::ceil(high + kCropMargin), 0.0, static_cast<double>(size));
    *first = static_cast<int>(begin);
    *count = static_cast<int>(end - begin);
  };
  Crop crop;
  crop.index = index;
  ImagePart& part = crop.part;
  range(box.min().x(), box.max().x(), view.width, &part.x, &part.width);
  range(box.min().y(), box.max().y(), view.height, &part.y, &part.height);
  if (part.width < 2 * kCropMargin || part.height < 2 * kCropMargin) return std::nullopt;
  return crop;
}

ObjectView CropView(const ObjectView& view, const ImagePart& part, int factor) {
  ObjectView cropped = view;
  cropped.width = part.width / factor;
  cropped.height = part.height / factor;
  cropped.fx /= factor;
  cropped.fy /= factor;
  cropped.cx = (view.cx - part.x) / factor;
  cropped.cy = (view.cy - part.y) / factor;
  return cropped;
}

double MeanEdge(const TriangleMesh& mesh) {
  double sum = 0;
  for (const auto& triangle : mesh.triangles) {
    sum += (mesh.vertices[triangle[0]] - mesh.vertices[triangle[1]]).norm();
  }
  return sum / static_cast<double>(mesh.triangles.size());
}

class Refiner {
 public:
  Refiner(const MeshRefinementOptions& options, Reporter& reporter, TriangleMesh* mesh)
      : options_(options),
        num_threads_(options.num_threads > 0 ? options.num_threads : omp_get_max_threads()),
        reporter_(reporter),
        mesh_(*mesh),
        scratch_(num_threads_) {}

  void LoadPhotos(const RefinementPhotoSource& source) {
    std::vector<Crop> crops;
    crops.reserve(source.size());
    double bytes = 0;
    double finest = std::numeric_limits<double>::infinity();  // pixel at the mesh
    Eigen::Vector3d middle = Eigen::Vector3d::Zero();
    for (const Eigen::Vector3f& vertex : mesh_.vertices) middle += vertex.cast<double>();
    middle /= static_cast<double>(mesh_.vertices.size());
    for (int i = 0; i < source.size(); ++i) {
      const ObjectView& view = source.Camera(i);
      const std::optional<Crop> crop = FindCrop(mesh_, view, i);
      if (!crop) continue;
      crops.push_back(*crop);
      bytes += kPyramidBytesPerPixel * crop->part.width * crop->part.height;
      finest = std::min(finest, (view.cam_from_object * middle).z() / std::max(view.fx, view.fy));
    }
    const double edge = MeanEdge(mesh_);
    int factor = 1;
    while (factor < kMaxShrink && (finest * 2 * factor < kPixelPerEdge * edge ||
                                   bytes / (factor * factor) > options_.max_memory_gib * kGiB)) {
      ++factor;
    }
    if (bytes / (factor * factor) > options_.max_memory_gib * kGiB) {
      throw UserError(
          fmt::format("{} photos need {:.1f} GiB to refine the mesh even at {} of their size, but "
                      "max_memory_gib is {}. Raise it, or leave the refinement out",
                      crops.size(), bytes / (factor * factor) / kGiB, 1.0 / factor, options_.max_memory_gib));
    }
    views_.resize(crops.size());
    std::vector<std::unique_ptr<PhotoPyramid>> photos(crops.size());
    const auto group = static_cast<size_t>(4 * num_threads_);
    for (size_t begin = 0; begin < crops.size(); begin += group) {
      if (reporter_.StopRequested()) throw Interrupted();
      const size_t end = std::min(begin + group, crops.size());
      ParallelFor(static_cast<int64_t>(end - begin), num_threads_, [&](int64_t i) {
        const Crop& crop = crops[begin + i];
        const Image8 photo = source.Load(crop.index);
        const ObjectView& view = source.Camera(crop.index);
        S2GS_INVARIANT(photo.channels == 1 && photo.width == view.width && photo.height == view.height);
        views_[begin + i] = CropView(view, crop.part, factor);
        photos[begin + i] =
            std::make_unique<PhotoPyramid>(views_[begin + i], CutAndShrink(photo, crop.part, factor));
      });
      reporter_.Progress("read photos", static_cast<int64_t>(end), static_cast<int64_t>(crops.size()));
    }
    photos_ = std::move(photos);
  }

  size_t num_photos() const { return photos_.size(); }

  // \return  how many triangles.
  int64_t DropUnseen() {
    if (!(options_.min_seen_pct > 0) || views_.size() < kMinPhotosToDrop) return 0;
    const std::vector<VertexFlags> visible = FindVisible({kMinSeenCosine, 0});
    const int needed = std::max(
        2, static_cast<int>(std::lround(options_.min_seen_pct / 100 * static_cast<double>(views_.size()))));
    const auto is_seen = [&](uint32_t vertex) {
      int count = 0;
      for (const VertexFlags& flags : visible) count += flags.Get(vertex) ? 1 : 0;
      return count >= needed;
    };
    std::vector<bool> vertex_seen;
    vertex_seen.reserve(mesh_.vertices.size());
    for (size_t i = 0; i < mesh_.vertices.size(); ++i) vertex_seen.push_back(is_seen(i));
    std::vector<bool> keep;
    keep.reserve(mesh_.triangles.size());
    for (const auto& triangle : mesh_.triangles) {
      keep.push_back(vertex_seen[triangle[0]] && vertex_seen[triangle[1]] && vertex_seen[triangle[2]]);
    }
    const int64_t dropped = std::count(keep.begin(), keep.end(), false);
    // A mesh that the photos do not show at all is not for them to judge.
    if (dropped == static_cast<int64_t>(keep.size())) return 0;
    KeepTriangles(keep, &mesh_);
    ComputeNormals(&mesh_);
    return dropped;
  }

  // The mesh keeps its vertices and triangles from here on.
  void BeginPasses() {
    graph_.emplace(mesh_);
    relief_.emplace(mesh_);
    moved_.assign(mesh_.vertices.size(), 0);
    moved_px_.assign(mesh_.vertices.size(), 0);
  }

  void Run(const Pass& pass, int64_t done_before, int64_t total) {
    const size_t count = mesh_.vertices.size();
    visible_ = FindVisible({static_cast<float>(std::cos(options_.max_view_angle_deg * kPi / 180)),
                            kVisibilityMargin << pass.level});
    if (course_.empty()) {
      measured_visible_ = visible_;
      NoteAgreement();
    }
    const int width = 2 * pass.max_steps + 1;
    curves_.assign(count * width, 0);
    pixels_.assign(count, 0);
    is_known_.assign(count, 0);
    num_views_.assign(count, 0);
    for (size_t begin = 0; begin < count; begin += kVerticesPerTurn) {
      if (reporter_.StopRequested()) throw Interrupted();
      const auto size = static_cast<int64_t>(std::min<size_t>(kVerticesPerTurn, count - begin));
      ParallelFor(size, num_threads_, 128, [&](int64_t i) { MeasureCurve(begin + i, pass); });
      reporter_.Progress("refine the mesh", done_before + static_cast<int64_t>(begin) + size, total);
    }
    AverageOverNeighbors(*graph_, is_known_, width, kAverageRounds, num_threads_, &curves_);
    std::vector<OffsetObservation> observations(count);
    for (size_t i = 0; i < count; ++i) {
      if (is_known_[i] == 0) continue;
      observations[i] = FindPeak(&curves_[i * width], pass);
      // Each photo more is one more comparison.
      observations[i].weight *=
          static_cast<float>(num_views_[i] - 1) / static_cast<float>(options_.num_views - 1);
    }
    num_accepted_ = std::count_if(observations.begin(), observations.end(),
                                  [](const OffsetObservation& o) { return o.weight > 0; });
    if (static_cast<double>(num_accepted_) < kLeastAcceptedShare * static_cast<double>(count)) return;
    // Vertices that no photo shows move as far as those around them.
    SpreadPixels();
    // A pass says where the surface is and takes the place of those before: were its own moves made smooth
    // and added to theirs, their noise would stay.
    for (size_t i = 0; i < count; ++i) observations[i].offset += moved_[i] / pixels_[i];
    const std::vector<float> offsets =
        SmoothOffsets(*graph_, observations, options_.smoothness, kPrior, num_threads_);
    for (size_t i = 0; i < count; ++i) {
      const float offset = offsets[i] - moved_[i] / pixels_[i];
      mesh_.vertices[i] += offset * pixels_[i] * mesh_.normals[i];
      moved_[i] += offset * pixels_[i];
      moved_px_[i] += offset;
    }
    ComputeNormals(&mesh_);
    has_moved_ = true;
    NoteAgreement();
  }

  void Summarise(MeshRefinementSummary* summary) const {
    double sum = 0;
    double squares = 0;
    for (const float offset : moved_px_) {
      sum += offset;
      squares += static_cast<double>(offset) * offset;
    }
    const auto count = static_cast<double>(std::max<size_t>(1, moved_px_.size()));
    summary->num_vertices = static_cast<int64_t>(moved_px_.size());
    summary->num_accepted = num_accepted_;
    summary->mean_offset_px = sum / count;
    summary->rms_offset_px = std::sqrt(squares / count);
    summary->course = course_;
    summary->has_moved = has_moved_;
  }

 private:
  std::vector<VertexFlags> FindVisible(const VisibilityRule& rule) const {
    if (reporter_.StopRequested()) throw Interrupted();
    std::vector<VertexFlags> visible(views_.size());
    ParallelFor(static_cast<int64_t>(views_.size()), num_threads_,
                [&](int64_t i) { visible[i] = FindVisibleVertices(mesh_, views_[i], rule); });
    return visible;
  }

  // The surface at a vertex with the photos that are compared there.
  SurfacePatch PatchAt(size_t vertex, const std::vector<VertexFlags>& visible) const {
    std::vector<const PhotoPyramid*> candidates;
    candidates.reserve(photos_.size());
    for (size_t i = 0; i < photos_.size(); ++i) {
      if (visible[i].Get(vertex)) candidates.push_back(photos_[i].get());
    }
    SurfacePatch patch;
    patch.middle = mesh_.vertices[vertex];
    patch.normal = mesh_.normals[vertex];
    SelectPhotos(candidates, options_.num_views, &patch);
    return patch;
  }

  // Where the mesh is now, by what was visible at first: at all moments the same places in the same photos.
  void NoteAgreement() {
    const size_t every = std::max<size_t>(1, mesh_.vertices.size() / kMeasuredVertices);
    std::vector<float> agreement(mesh_.vertices.size() / every, std::numeric_limits<float>::quiet_NaN());
    ParallelFor(static_cast<int64_t>(agreement.size()), num_threads_, 128, [&](int64_t i) {
      SurfacePatch patch = PatchAt(static_cast<size_t>(i) * every, measured_visible_);
      if (patch.num_views < kMinViews) return;
      patch.LayFlat(0);
      ConsistencyCurve(patch, 0, patch.PixelSize(), 0, &agreement[static_cast<size_t>(i)]);
    });
    double sum = 0;
    int64_t count = 0;
    for (const float value : agreement) {
      if (!std::isfinite(value)) continue;
      sum += value;
      ++count;
    }
    if (count > 0) course_.push_back({SteadySeconds() - started_, 1 - sum / static_cast<double>(count)});
  }

  void MeasureCurve(size_t vertex, const Pass& pass) {
    SurfacePatch patch = PatchAt(vertex, visible_);
    if (patch.num_views < kMinViews) return;
    patch.LayFlat(pass.level);
    if (pass.on_mesh) {
      relief_->Lay(static_cast<uint32_t>(vertex), &scratch_[omp_get_thread_num()], &patch);
      if (patch.num_points < kLeastPatchPoints) return;
    }
    num_views_[vertex] = static_cast<uint8_t>(patch.num_views);
    pixels_[vertex] = patch.PixelSize();
    is_known_[vertex] = 1;
    ConsistencyCurve(patch, pass.level, pass.step * pixels_[vertex], pass.max_steps,
                     &curves_[vertex * (2 * pass.max_steps + 1)]);
  }

  // The highest peak, in pixels, and how much it counts: its curvature, less where it is low or not alone.
  static OffsetObservation FindPeak(const float* curve, const Pass& pass) {
    const int width = 2 * pass.max_steps + 1;
    const auto best = static_cast<int>(std::max_element(curve, curve + width) - curve);
    if (best == 0 || best == width - 1) return {};
    const float curvature = 2 * curve[best] - curve[best - 1] - curve[best + 1];
    const float sharpness = curvature / (pass.step * pass.step);
    if (!(std::ldexp(sharpness, 2 * pass.level) > kLeastSharpness) || !(curve[best] > kNoTrust)) return {};
    float trust = std::min(1.0F, (curve[best] - kNoTrust) / (kFullTrust - kNoTrust));
    trust *= trust;
    for (int i = 1; i + 1 < width; ++i) {
      if (std::abs(i - best) <= 1 || curve[i] <= curve[i - 1] || curve[i] <= curve[i + 1]) continue;
      if (curve[i] > kRivalShare * curve[best]) trust = std::min(trust, kRivalTrust);
    }
    const float fraction = (curve[best + 1] - curve[best - 1]) / (2 * curvature);
    const float offset = (static_cast<float>(best - pass.max_steps) + fraction) * pass.step;
    return {offset, trust * sharpness};
  }

  void SpreadPixels() {
    double sum = 0;
    int64_t num_known = 0;
    for (size_t i = 0; i < pixels_.size(); ++i) {
      sum += pixels_[i];
      num_known += is_known_[i];
    }
    if (num_known == 0) return;
    const auto mean = static_cast<float>(sum / static_cast<double>(num_known));
    for (size_t i = 0; i < pixels_.size(); ++i) {
      if (is_known_[i] == 0) pixels_[i] = mean;
    }
  }

  const MeshRefinementOptions& options_;
  const int num_threads_;
  Reporter& reporter_;
  TriangleMesh& mesh_;
  std::vector<ObjectView> views_;  // as the photos are: cut and shrunk
  std::vector<std::unique_ptr<PhotoPyramid>> photos_;
  std::optional<VertexGraph> graph_;
  std::optional<SurfaceRelief> relief_;
  std::vector<SurfaceRelief::Scratch> scratch_;  // of each thread
  std::vector<VertexFlags> visible_;
  std::vector<VertexFlags> measured_visible_;
  std::vector<float> curves_;
  std::vector<float> pixels_;  // size of a photo's pixel at each vertex
  std::vector<uint8_t> is_known_;
  std::vector<uint8_t> num_views_;  // compared at each vertex
  std::vector<float> moved_;        // outwards since the start
  std::vector<float> moved_px_;     // the same [px]
  int64_t num_accepted_ = 0;
  bool has_moved_ = false;
  std::vector<RefinementMoment> course_;
  double started_ = SteadySeconds();
};

}  // namespace

OptionCheck MeshRefinementOptions::Check() const {
  const auto fault = [](const char* field, double value, const char* bound) {
    return OptionFault{field, fmt::format("{}", value), bound};
  };
  if (num_views < kMinViews || num_views > SurfacePatch::kMaxViews) {
    return fault("num_views", num_views, "3 <= num_views <= 16");
  }
  if (!(max_view_angle_deg > 0) || !(max_view_angle_deg <= 85)) {
    return fault("max_view_angle_deg", max_view_angle_deg, "0 < max_view_angle_deg <= 85");
  }
  if (!(smoothness > 0) || !(smoothness <= 1e6)) {
    return fault("smoothness", smoothness, "0 < smoothness <= 1000000");
  }
  if (!(min_seen_pct >= 0) || !(min_seen_pct <= 100)) {
    return fault("min_seen_pct", min_seen_pct, "0 <= min_seen_pct <= 100");
  }
  if (!(max_memory_gib > 0) || !(max_memory_gib <= 1'048'576)) {
    return fault("max_memory_gib", max_memory_gib, "0 < max_memory_gib <= 1048576");
  }
  if (num_threads < 0 || num_threads > 4096) {
    return fault("num_threads", num_threads, "0 <= num_threads <= 4096");
  }
  return std::nullopt;
}

MeshRefinementSummary RefineMesh(const RefinementPhotoSource& photos, const MeshRefinementOptions& options,
                                 Reporter& reporter, TriangleMesh* mesh) {
  const double start = SteadySeconds();
  MeshRefinementSummary summary;
  if (!options.enabled || mesh->triangles.empty()) return summary;
  ComputeNormals(mesh);
  Refiner refiner(options, reporter, mesh);
  refiner.LoadPhotos(photos);
  summary.num_photos = static_cast<int>(refiner.num_photos());
  if (summary.num_photos < kMinRefinementPhotos) return summary;
  summary.num_unseen_triangles = refiner.DropUnseen();
  refiner.BeginPasses();
  const auto count = static_cast<int64_t>(mesh->vertices.size());
  const auto total = static_cast<int64_t>(kPasses.size()) * count;
  for (size_t i = 0; i < kPasses.size(); ++i) {
    refiner.Run(kPasses[i], static_cast<int64_t>(i) * count, total);
  }
  refiner.Summarise(&summary);
  summary.num_unseen_triangles += refiner.DropUnseen();
  summary.seconds = SteadySeconds() - start;
  return summary;
}

}  // namespace s2gs
