#include "mesh/refine/surface_carving.h"

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <numeric>
#include <vector>

#include "mesh/refine/photo_consistency.h"
#include "mesh/surface/vertex_normals.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {
namespace {

// Patches of 25 points that have nothing in common correlate by .2 (one standard deviation). Of three photos
// and more, averaged over a vertex's surroundings, it is less than .05.
constexpr float kChance = 0.05F;
// A surface is contradicted up to here, which chance exceeds in one of 700,
constexpr float kContradicted = 3 * kChance;
// goes on sinking up to here, where the refinement's peaks begin to count,
constexpr float kAgreed = 0.4F;
// and stays where it agrees by so much in the mean.
constexpr float kLeastGain = 2 * kContradicted;
// Of a part's vertices with evidence: so many may be contradicted at its end,
constexpr double kMaxContradictedShare = 0.15;
// and so many of all must have evidence there.
constexpr double kLeastKnownShare = 0.3;
// Share of the brightness beside noise: texture is as strong as noise. Overexposed white has none.
constexpr float kLeastTexture = 0.5F;
// Of the patch around a vertex [px].
constexpr int kMargin = kPatchSide / 2;
constexpr int kAverageRounds = 3;
// The passes before find what lies within 6 pixels, and hollows much deeper than wide show no photo their
// floor.
constexpr int kMaxRounds = 15;
// Which photos see what is looked at again when this many pixels have gone, which is what visibility
// tolerates.
constexpr int kRoundsPerView = 2;
// What sinks takes so many rings of neighbours along, and is made even so many times.
constexpr int kSpreadRounds = 2;
constexpr int kFairingRounds = 2;
// A vertex that sank by less is at the rim [px].
constexpr float kLeastDepth = 0.5F;

class Carving {
 public:
  Carving(const RefinementPhotos& photos, const VertexGraph& graph, int num_views, int num_threads,
          TriangleMesh* mesh)
      : photos_(photos),
        graph_(graph),
        num_views_(num_views),
        num_threads_(num_threads),
        mesh_(*mesh),
        raw_(graph.size()),
        pixels_(graph.size()),
        is_known_(graph.size()),
        is_sinking_(graph.size()),
        depths_(graph.size()) {}

  std::vector<uint32_t> Run() {
    const std::vector<Eigen::Vector3f> start = mesh_.vertices;
    std::vector<uint8_t> is_near(graph_.size(), 1);
    for (int round = 0;; ++round) {
      if (round % kRoundsPerView == 0) {
        visible_ = photos_.FindVisible(mesh_, {kMinSeenCosine, kMargin});
      }
      Measure(is_near);
      if (round == kMaxRounds || !FindSinking()) return PutBack(start);
      Sink();
      is_near = is_sinking_;
      GrowByNeighbors(graph_, kSpreadRounds + kAverageRounds, &is_near);
    }
  }

 private:
  // What may have changed.
  void Measure(const std::vector<uint8_t>& is_near) {
    ParallelFor(static_cast<int64_t>(graph_.size()), num_threads_, 128, [&](int64_t i) {
      if (is_near[i] == 0) return;
      is_known_[i] = 0;
      raw_[i] = 0;
      SurfacePatch patch = photos_.PatchAt(mesh_, i, visible_, num_views_);
      if (patch.num_views < kLeastPhotosCompared) return;
      patch.LayFlat(0);
      pixels_[i] = patch.PixelSize();
      const PatchAgreement agreement = MeasureAgreement(patch);
      if (!(agreement.texture > kLeastTexture)) return;
      is_known_[i] = 1;
      raw_[i] = agreement.correlation;
    });
    correlation_ = raw_;
    AverageOverNeighbors(graph_, is_known_, 1, kAverageRounds, num_threads_, &correlation_);
  }

  bool IsContradicted(size_t i) const { return is_known_[i] != 0 && correlation_[i] < kContradicted; }

  // \return  whether there are any.
  bool FindSinking() {
    bool any = false;
    for (size_t i = 0; i < graph_.size(); ++i) {
      const float bound = is_sinking_[i] != 0 ? kAgreed : kContradicted;
      is_sinking_[i] = is_known_[i] != 0 && correlation_[i] < bound ? 1 : 0;
      any = any || is_sinking_[i] != 0;
    }
    return any;
  }

  void Sink() {
    std::vector<float> steps(is_sinking_.begin(), is_sinking_.end());
    for (size_t i = 0; i < steps.size(); ++i) steps[i] *= pixels_[i];
    AverageOverNeighbors(graph_, std::vector<uint8_t>(graph_.size(), 1), 1, kSpreadRounds, num_threads_,
                         &steps);
    // Some sinks, so that there is one.
    const auto num_measured = std::count_if(pixels_.begin(), pixels_.end(), [](float p) { return p > 0; });
    const auto mean_pixel = static_cast<float>(std::accumulate(pixels_.begin(), pixels_.end(), 0.0) /
                                               static_cast<double>(num_measured));
    for (size_t i = 0; i < steps.size(); ++i) {
      mesh_.vertices[i] -= steps[i] * mesh_.normals[i];
      depths_[i] += steps[i] / (pixels_[i] > 0 ? pixels_[i] : mean_pixel);
    }
    for (int round = 0; round < kFairingRounds; ++round) {
      const std::vector<Eigen::Vector3f> before = mesh_.vertices;
      for (size_t i = 0; i < before.size(); ++i) {
        if (!(depths_[i] > kLeastDepth)) continue;
        Eigen::Vector3f mean = Eigen::Vector3f::Zero();
        for (const uint32_t j : graph_.Neighbors(i)) mean += before[j];
        mean /= static_cast<float>(graph_.Neighbors(i).size());
        mesh_.vertices[i] = (before[i] + mean) / 2;
      }
    }
    ComputeNormals(&mesh_);
  }

  // Parts that have found no agreement. \return  the vertices of the others.
  std::vector<uint32_t> PutBack(const std::vector<Eigen::Vector3f>& start) {
    std::vector<uint32_t> deeper;
    std::vector<uint8_t> is_done(graph_.size());
    for (size_t seed = 0; seed < graph_.size(); ++seed) {
      if (is_done[seed] != 0 || !(depths_[seed] > 0)) continue;
      is_done[seed] = 1;
      std::vector<uint32_t> part = {static_cast<uint32_t>(seed)};
      for (size_t next = 0; next < part.size(); ++next) {
        for (const uint32_t j : graph_.Neighbors(part[next])) {
          if (is_done[j] != 0 || !(depths_[j] > 0)) continue;
          is_done[j] = 1;
          part.push_back(j);
        }
      }
      if (Agrees(part)) {
        deeper.insert(deeper.end(), part.begin(), part.end());
        continue;
      }
      for (const uint32_t i : part) mesh_.vertices[i] = start[i];
    }
    ComputeNormals(&mesh_);
    return deeper;
  }

  bool Agrees(const std::vector<uint32_t>& part) const {
    int64_t num_deep = 0;
    int64_t num_known = 0;
    int64_t num_contradicted = 0;
    double sum = 0;
    for (const uint32_t i : part) {
      if (!(depths_[i] > kLeastDepth)) continue;
      ++num_deep;
      if (is_known_[i] == 0) continue;
      ++num_known;
      sum += correlation_[i];
      num_contradicted += IsContradicted(i) ? 1 : 0;
    }
    const auto known = static_cast<double>(num_known);
    return num_known > 0 && known >= kLeastKnownShare * static_cast<double>(num_deep) &&
           static_cast<double>(num_contradicted) <= kMaxContradictedShare * known &&
           sum >= kLeastGain * known;
  }

  const RefinementPhotos& photos_;
  const VertexGraph& graph_;
  const int num_views_;
  const int num_threads_;
  TriangleMesh& mesh_;
  std::vector<VertexFlags> visible_;
  std::vector<float> raw_;          // correlation of the photos
  std::vector<float> correlation_;  // averaged over a vertex's surroundings
  std::vector<float> pixels_;       // size of a photo's pixel; 0: not known yet
  std::vector<uint8_t> is_known_;   // photos see texture there
  std::vector<uint8_t> is_sinking_;
  std::vector<float> depths_;  // below the start [px]
};

}  // namespace

std::vector<uint32_t> CarveContradicted(const RefinementPhotos& photos, const VertexGraph& graph,
                                        int num_views, int num_threads, TriangleMesh* mesh) {
  return Carving(photos, graph, num_views, num_threads, mesh).Run();
}

}  // namespace s2gs
