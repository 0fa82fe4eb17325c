#include "mesh/refine/refuted_surface.h"

#include <cstddef>

#include "mesh/refine/photo_consistency.h"
#include "mesh/refine/surface_relief.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {
namespace {

// Edge of a patch's points [px]. A single patch judges, not the mean over a vertex's surroundings and not a
// peak's place: wider ones have more to go by.
constexpr float kSpacing = 1.5F;
// Share of the brightness's variance in a photo that counts: texture of more than 1.15 times the noise.
constexpr float kLeastTexture = 0.7F;
// A vertex is judged with the two rings around it.
constexpr int kRings = 2;

}  // namespace

std::vector<uint8_t> FindRefuted(const RefinementPhotos& photos, const VertexGraph& graph,
                                 const TriangleMesh& mesh, int num_threads) {
  const std::vector<VertexFlags> visible = photos.FindVisible(mesh, {kMinSeenCosine, 0});
  const SurfaceRelief relief(mesh);
  std::vector<SurfaceRelief::Scratch> scratch(num_threads);
  std::vector<float> refuted(graph.size());
  ParallelFor(static_cast<int64_t>(graph.size()), num_threads, 128, [&](int64_t i) {
    SurfacePatch patch = photos.PatchAt(mesh, i, visible, SurfacePatch::kMaxViews);
    if (patch.num_views < 2) return;
    patch.LayFlat(0);
    patch.spacing *= kSpacing;
    // What a thin part does not fill of the patch shows something else in each photo.
    relief.Lay(static_cast<uint32_t>(i), &scratch[LoopThread()], &patch);
    if (patch.num_points < kLeastPatchPoints) return;
    refuted[i] = PhotosDisagree(patch, kLeastTexture) ? 1.0F : 0.0F;
  });
  AverageOverNeighbors(graph, std::vector<uint8_t>(graph.size(), 1), 1, kRings, num_threads, &refuted);
  std::vector<uint8_t> result;
  result.reserve(refuted.size());
  for (const float share : refuted) result.push_back(share > 0.5F ? 1 : 0);
  return result;
}

}  // namespace s2gs
