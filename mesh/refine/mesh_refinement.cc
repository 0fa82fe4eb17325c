#include "mesh/refine/mesh_refinement.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <vector>

#include "mesh/light/shaded_normals.h"
#include "mesh/light/turn_light.h"
#include "mesh/refine/normal_integration.h"
#include "mesh/refine/offset_field.h"
#include "mesh/refine/parts_borne_out.h"
#include "mesh/refine/photo_consistency.h"
#include "mesh/refine/refinement_photos.h"
#include "mesh/refine/refuted_surface.h"
#include "mesh/refine/surface_carving.h"
#include "mesh/refine/surface_relief.h"
#include "mesh/refine/vertex_visibility.h"
#include "mesh/surface/mesh_cleanup.h"
#include "mesh/surface/vertex_normals.h"
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

// With fewer, a part that one photo shows may well be there: of 24 photos what is lost outweighs what is
// gained, of 30 no more (tests/bench/notes/refinement.md).
constexpr size_t kMinPhotosToAskTwo = 30;
// What is dropped uncovers what photos refute, too, and that little more.
constexpr int kDropRounds = 3;
// Around a vertex, as far as its patch reaches, the photo must show the mesh and nothing in front of it [px
// of the pyramid's level].
constexpr int kVisibilityMargin = kPatchSide / 2;
// Around a vertex whose brightness is asked for, so that nothing in front of it adds to it [px].
constexpr int kShadingMargin = 1;
// How often places are averaged for what shadows itself: over some two edges.
constexpr int kSmoothRounds = 5;
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
// Beside 1 for a peak that falls by 1 in a pixel: what is not carved stays, and its neighbours join it.
constexpr float kHeld = 1000;
constexpr int kRingsAroundCarved = 5;
constexpr int64_t kVerticesPerTurn = 16384;

class Refiner {
 public:
  Refiner(const MeshRefinementOptions& options, Reporter& reporter, TriangleMesh* mesh)
      : options_(options),
        num_threads_(NumThreadsOf(options.num_threads)),
        reporter_(reporter),
        mesh_(*mesh),
        photos_(num_threads_, reporter),
        scratch_(num_threads_) {}

  void LoadPhotos(const RefinementPhotoSource& source) {
    photos_.Load(source, mesh_, options_.max_memory_gib);
  }
  size_t num_photos() const { return photos_.size(); }
  const std::vector<Eigen::Matrix3d>& world_from_object() const { return photos_.world_from_object(); }

  // \return  how many triangles.
  int64_t DropUnseen() {
    if (!(options_.min_seen_pct > 0)) return 0;
    const std::vector<VertexFlags> visible = photos_.FindVisible(mesh_, {kMinSeenCosine, 0});
    const auto share =
        static_cast<int>(std::lround(options_.min_seen_pct / 100 * static_cast<double>(photos_.size())));
    const int needed = photos_.size() < kMinPhotosToAskTwo ? 1 : std::max(2, share);
    std::vector<uint8_t> is_unseen(mesh_.vertices.size());
    for (size_t i = 0; i < is_unseen.size(); ++i) {
      const auto count = std::count_if(visible.begin(), visible.end(),
                                       [i](const VertexFlags& flags) { return flags.Get(i); });
      is_unseen[i] = count < needed ? 1 : 0;
    }
    // On rough even faces many vertices are turned away from all photos, which see the triangles there all
    // the same. They stay where there is no other surface for what the photos show.
    std::vector<bool> keep = TrianglesWithout(is_unseen);
    const std::vector<bool> is_closing = photos_.FindClosing(mesh_, keep, needed);
    for (size_t i = 0; i < keep.size(); ++i) keep[i] = keep[i] || is_closing[i];
    return Keep(keep);
  }

  // \return  how many triangles.
  int64_t DropSeenThrough() {
    if (!photos_.ShowPlane()) return 0;
    return Keep(
        TrianglesWithout(photos_.FindSeenThrough(mesh_, photos_.FindVisible(mesh_, {kMinSeenCosine, 0}))));
  }

  // \return  how many triangles.
  int64_t DropRefuted() {
    return Keep(TrianglesWithout(FindRefuted(photos_, VertexGraph(mesh_), mesh_, num_threads_)));
  }

  // \return  how many triangles.
  int64_t DropPartsNotBorneOut(double height) {
    return Keep(TrianglesWithout(FindPartsNotBorneOut(photos_, mesh_, height, num_threads_)));
  }

  // The mesh keeps its vertices and triangles from here on.
  void BeginPasses() {
    graph_.emplace(mesh_);
    relief_.emplace(mesh_);
    moved_.assign(mesh_.vertices.size(), 0);
    moved_px_.assign(mesh_.vertices.size(), 0);
    is_open_.assign(mesh_.vertices.size(), 1);
  }

  void Run(const Pass& pass, int64_t done_before, int64_t total) {
    const size_t count = mesh_.vertices.size();
    visible_ =
        photos_.FindVisible(mesh_, {static_cast<float>(std::cos(options_.max_view_angle_deg * kPi / 180)),
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
      if (is_open_[i] == 0) observations[i].weight = kHeld;
      if (is_known_[i] == 0) continue;
      observations[i] = FindPeak(&curves_[i * width], pass);
      // Each photo more is one more comparison.
      observations[i].weight *=
          static_cast<float>(num_views_[i] - 1) / static_cast<float>(options_.num_views - 1);
    }
    const int64_t num_accepted = std::count_if(observations.begin(), observations.end(),
                                               [](const OffsetObservation& o) { return o.weight > 0; });
    // The first pass decides for all: it moves the surface to where the others can see it.
    if (!is_clear_) {
      num_clear_ = num_accepted;
      is_clear_ =
          100 * static_cast<double>(num_accepted) >= options_.least_clear_pct * static_cast<double>(count);
    }
    if (num_accepted == 0 || !*is_clear_) return;
    if (num_carved_ == 0) num_accepted_ = num_accepted;
    // Vertices that no photo shows move as far as those around them. Of what was carved none may be shown.
    if (!SpreadPixels()) return;
    // A pass says where the surface is and takes the place of those before: were its own moves made smooth
    // and added to theirs, their noise would stay.
    for (size_t i = 0; i < count; ++i) observations[i].offset += moved_[i] / pixels_[i];
    const std::vector<float> offsets =
        SmoothOffsets(*graph_, observations, options_.smoothness, kPrior, num_threads_);
    for (size_t i = 0; i < count; ++i) {
      if (is_open_[i] == 0) continue;
      const float offset = offsets[i] - moved_[i] / pixels_[i];
      mesh_.vertices[i] += offset * pixels_[i] * mesh_.normals[i];
      moved_[i] += offset * pixels_[i];
      moved_px_[i] += offset;
    }
    ComputeNormals(&mesh_);
    has_moved_ = true;
    NoteAgreement();
  }

  // Small forms that photos' correlation does not resolve, by how light shades them.
  void FollowShading(MeshRefinementSummary* summary) {
    const std::vector<VertexFlags> visible = photos_.FindVisible(
        mesh_, {static_cast<float>(std::cos(options_.max_view_angle_deg * kPi / 180)), kShadingMargin});
    ShadedNormals shaded = FindShadedNormals(mesh_, Smoothed(*graph_, mesh_, kSmoothRounds, num_threads_),
                                             OverTable(), photos_.SampleShading(mesh_, *graph_, visible),
                                             photos_.world_from_object(), num_threads_);
    summary->error_even_light = shaded.error_even;
    summary->error_turn_light = shaded.error_lit;
    summary->is_lit = !shaded.normals.empty();
    if (!summary->is_lit) return;
    ToldNormals told{std::move(shaded.normals), std::move(shaded.sigma_rad), shaded.spread_rad};
    LeanAsMesh(*graph_, mesh_, num_threads_, &told);
    const std::vector<float> offsets = IntegrateNormals(*graph_, mesh_, told, num_threads_);
    const std::vector<Eigen::Vector3f> before = mesh_.vertices;
    for (size_t i = 0; i < offsets.size(); ++i) mesh_.vertices[i] += offsets[i] * mesh_.normals[i];
    ComputeNormals(&mesh_);
    NoteAgreement();
    // Where the light is hardly told, or the mesh is coarse, the photos agree worse on what it leads to.
    if (course_.size() > 1 && course_.back().disagreement > course_[course_.size() - 2].disagreement) {
      mesh_.vertices = before;
      ComputeNormals(&mesh_);
      const double as_before = course_[course_.size() - 2].disagreement;
      course_.push_back({SteadySeconds() - started_, as_before});
      return;
    }
    double squares = 0;
    for (size_t i = 0; i < offsets.size(); ++i) {
      const float offset_px = offsets[i] / photos_.FinestPixel(before[i]);
      moved_px_[i] += offset_px;
      summary->num_shaded += told.sigma_rad[i] > 0 ? 1 : 0;
      squares += std::pow(offset_px, 2);
    }
    if (summary->num_shaded > 0)
      summary->rms_shaded_px = std::sqrt(squares / static_cast<double>(summary->num_shaded));
  }

  // The next pass is for what lies deeper and its surroundings alone. \return  whether there is any.
  bool Carve() {
    if (!has_moved_ || !options_.carve) return false;
    const std::vector<uint32_t> deeper =
        CarveContradicted(photos_, *graph_, options_.num_views, num_threads_, &mesh_);
    num_carved_ = static_cast<int64_t>(deeper.size());
    std::fill(is_open_.begin(), is_open_.end(), 0);
    for (const uint32_t i : deeper) is_open_[i] = 1;
    GrowByNeighbors(*graph_, kRingsAroundCarved, &is_open_);
    return num_carved_ > 0;
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
    summary->num_clear = num_clear_;
    summary->num_accepted = num_accepted_;
    summary->num_carved = num_carved_;
    summary->mean_offset_px = sum / count;
    summary->rms_offset_px = std::sqrt(squares / count);
    summary->course = course_;
    summary->has_moved = has_moved_;
  }

 private:
  // Light changes a table's top by shadows alone as it turns, and most of what photos show may be of it.
  std::vector<uint8_t> OverTable() const {
    std::vector<uint8_t> is_over(mesh_.vertices.size(), 1);
    if (!options_.table_height) return is_over;
    for (size_t i = 0; i < is_over.size(); ++i)
      is_over[i] = mesh_.vertices[i].z() > *options_.table_height ? 1 : 0;
    return is_over;
  }

  // Where the mesh is now, by what was visible at first: at all moments the same places in the same photos.
  void NoteAgreement() {
    const size_t every = std::max<size_t>(1, mesh_.vertices.size() / kMeasuredVertices);
    std::vector<float> agreement(mesh_.vertices.size() / every, std::numeric_limits<float>::quiet_NaN());
    ParallelFor(static_cast<int64_t>(agreement.size()), num_threads_, 128, [&](int64_t i) {
      SurfacePatch patch =
          photos_.PatchAt(mesh_, static_cast<size_t>(i) * every, measured_visible_, options_.num_views);
      if (patch.num_views < kLeastPhotosCompared) return;
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

  // Those that have none of the vertices for a corner.
  std::vector<bool> TrianglesWithout(const std::vector<uint8_t>& vertices) const {
    std::vector<bool> keep;
    keep.reserve(mesh_.triangles.size());
    for (const auto& triangle : mesh_.triangles) {
      keep.push_back(vertices[triangle[0]] == 0 && vertices[triangle[1]] == 0 && vertices[triangle[2]] == 0);
    }
    return keep;
  }

  // \return  how many triangles are dropped.
  int64_t Keep(const std::vector<bool>& keep) {
    const int64_t dropped = std::count(keep.begin(), keep.end(), false);
    // A mesh that the photos do not show at all is not for them to judge.
    if (dropped == 0 || dropped == static_cast<int64_t>(keep.size())) return 0;
    KeepTriangles(keep, &mesh_);
    ComputeNormals(&mesh_);
    return dropped;
  }

  void MeasureCurve(size_t vertex, const Pass& pass) {
    if (is_open_[vertex] == 0) return;
    SurfacePatch patch = photos_.PatchAt(mesh_, vertex, visible_, options_.num_views);
    if (patch.num_views < kLeastPhotosCompared) return;
    patch.LayFlat(pass.level);
    if (pass.on_mesh) {
      relief_->Lay(static_cast<uint32_t>(vertex), &scratch_[LoopThread()], &patch);
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

  // \return  whether there is any.
  bool SpreadPixels() {
    double sum = 0;
    int64_t num_known = 0;
    for (size_t i = 0; i < pixels_.size(); ++i) {
      sum += pixels_[i];
      num_known += is_known_[i];
    }
    if (num_known == 0) return false;
    const auto mean = static_cast<float>(sum / static_cast<double>(num_known));
    for (size_t i = 0; i < pixels_.size(); ++i) {
      if (is_known_[i] == 0) pixels_[i] = mean;
    }
    return true;
  }

  const MeshRefinementOptions& options_;
  const int num_threads_;
  Reporter& reporter_;
  TriangleMesh& mesh_;
  RefinementPhotos photos_;
  std::optional<VertexGraph> graph_;
  std::optional<SurfaceRelief> relief_;
  std::vector<SurfaceRelief::Scratch> scratch_;  // of each thread
  std::vector<VertexFlags> visible_;
  std::vector<VertexFlags> measured_visible_;
  std::vector<float> curves_;
  std::vector<float> pixels_;  // size of a photo's pixel at each vertex
  std::vector<uint8_t> is_known_;
  std::vector<uint8_t> num_views_;  // compared at each vertex
  std::vector<uint8_t> is_open_;    // the others are held where they are
  std::vector<float> moved_;        // outwards since the start
  std::vector<float> moved_px_;     // the same [px]
  int64_t num_clear_ = 0;
  int64_t num_accepted_ = 0;
  int64_t num_carved_ = 0;
  std::optional<bool> is_clear_;  // whether enough vertices have a peak
  bool has_moved_ = false;
  std::vector<RefinementMoment> course_;
  double started_ = SteadySeconds();
};

}  // namespace

OptionCheck MeshRefinementOptions::Check() const {
  const auto fault = [](const char* field, double value, const char* bound) {
    return OptionFault{field, fmt::format("{}", value), bound};
  };
  if (num_views < kLeastPhotosCompared || num_views > SurfacePatch::kMaxViews) {
    return fault("num_views", num_views, "3 <= num_views <= 16");
  }
  if (!(max_view_angle_deg > 0) || !(max_view_angle_deg <= 85)) {
    return fault("max_view_angle_deg", max_view_angle_deg, "0 < max_view_angle_deg <= 85");
  }
  if (!(smoothness > 0) || !(smoothness <= 1e6)) {
    return fault("smoothness", smoothness, "0 < smoothness <= 1000000");
  }
  if (!(least_clear_pct >= 0) || !(least_clear_pct <= 100)) {
    return fault("least_clear_pct", least_clear_pct, "0 <= least_clear_pct <= 100");
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
  // Before the passes: what hides the surface from the photos keeps these from their place.
  for (int round = 0; round < kDropRounds && options.drop_seen_through; ++round) {
    const int64_t seen_through = refiner.DropSeenThrough();
    if (seen_through == 0) break;
    summary.num_seen_through += seen_through;
    summary.num_unseen_triangles += refiner.DropUnseen();
  }
  refiner.BeginPasses();
  const auto count = static_cast<int64_t>(mesh->vertices.size());
  const auto total = static_cast<int64_t>(kPasses.size()) * count;
  for (size_t i = 0; i < kPasses.size(); ++i) {
    refiner.Run(kPasses[i], static_cast<int64_t>(i) * count, total);
  }
  if (refiner.Carve()) refiner.Run(kPasses.back(), total - count, total);
  if (options.shading && Turns(refiner.world_from_object())) refiner.FollowShading(&summary);
  refiner.Summarise(&summary);
  if (options.drop_refuted && options.table_height)
    summary.num_refuted_triangles += refiner.DropPartsNotBorneOut(*options.table_height);
  summary.num_unseen_triangles += refiner.DropUnseen();
  for (int round = 0; round < kDropRounds; ++round) {
    const int64_t seen_through = options.drop_seen_through ? refiner.DropSeenThrough() : 0;
    summary.num_seen_through += seen_through;
    const int64_t refuted = options.drop_refuted ? refiner.DropRefuted() : 0;
    if (refuted + seen_through == 0) break;
    summary.num_refuted_triangles += refuted;
    summary.num_unseen_triangles += refiner.DropUnseen();
  }
  summary.seconds = SteadySeconds() - start;
  return summary;
}

}  // namespace s2gs
