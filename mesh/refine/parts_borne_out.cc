#include "mesh/refine/parts_borne_out.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "mesh/refine/photo_consistency.h"
#include "mesh/surface/parts_on_table.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {
namespace {

// Share of the brightness's variance that is texture: as strong as noise.
constexpr float kLeastTexture = 0.5F;
// Of a part's places with texture, so many tell: four patches, side by side.
constexpr int64_t kLeastPlaces = 4 * kPatchSize;
// Mean correlation of a part. Of parts that float it is chance, -.01 to .05 (a patch's deviation of .2 over
// 20 to 100 patches side by side); of true ones .34 to .70, whether refined or not.
constexpr double kNotBorneOut = 0.15;
// Twice that, which the largest part must have.
constexpr double kBorneOut = 2 * kNotBorneOut;

struct Part {
  int64_t vertices = 0;
  int64_t places = 0;  // with texture
  double sum = 0;      // of their correlations
  double Mean() const { return places > 0 ? sum / static_cast<double>(places) : 0; }
};

}  // namespace

std::vector<uint8_t> FindPartsNotBorneOut(const RefinementPhotos& photos, const TriangleMesh& mesh,
                                          double height, int num_threads) {
  const size_t count = mesh.vertices.size();
  std::vector<uint8_t> flags(count, 0);
  const std::vector<int> part_of = PartsAbove(height, mesh);
  if (part_of.empty()) return flags;
  std::vector<Part> parts(*std::max_element(part_of.begin(), part_of.end()) + 1);
  if (parts.size() < 2) return flags;

  const std::vector<VertexFlags> visible = photos.FindVisible(mesh, {kMinSeenCosine, kPatchSide / 2});
  std::vector<PatchAgreement> agreement(count);
  ParallelFor(static_cast<int64_t>(count), num_threads, 128, [&](int64_t i) {
    if (part_of[i] == kNoPart) return;
    SurfacePatch patch = photos.PatchAt(mesh, i, visible, SurfacePatch::kMaxViews);
    if (patch.num_views < kLeastPhotosCompared) return;
    patch.LayFlat(0);
    agreement[i] = MeasureAgreement(patch);
  });
  for (size_t i = 0; i < count; ++i) {
    if (part_of[i] == kNoPart) continue;
    Part& part = parts[part_of[i]];
    ++part.vertices;
    if (!(agreement[i].texture >= kLeastTexture)) continue;
    ++part.places;
    part.sum += agreement[i].correlation;
  }
  const auto largest = std::max_element(parts.begin(), parts.end(),
                                        [](const Part& a, const Part& b) { return a.vertices < b.vertices; });
  if (!(largest->Mean() >= kBorneOut)) return flags;
  for (size_t i = 0; i < count; ++i) {
    if (part_of[i] == kNoPart) continue;
    const Part& part = parts[part_of[i]];
    if (part.places >= kLeastPlaces && part.Mean() < kNotBorneOut) flags[i] = 1;
  }
  return flags;
}

}  // namespace s2gs
