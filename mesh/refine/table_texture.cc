#include "mesh/refine/table_texture.h"

#include <algorithm>
#include <cstddef>

#include "mesh/refine/photo_consistency.h"
#include "mesh/refine/refinement_photos.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {
namespace {

constexpr int kMaxPhotos = 24;
constexpr size_t kMaxVertices = 2000;
constexpr int kViews = 4;  // at a vertex: texture is seen by each of them
// Share of the brightness's variance: texture is as strong as noise.
constexpr float kLeastTexture = 0.5F;

// Some of the photos.
class EvenlyChosen : public RefinementPhotoSource {
 public:
  explicit EvenlyChosen(const RefinementPhotoSource& all) : all_(all) {}
  int size() const override { return std::min(kMaxPhotos, all_.size()); }
  const ObjectView& Camera(int index) const override { return all_.Camera(IndexOf(index)); }
  Image8 Load(int index) const override { return all_.Load(IndexOf(index)); }

 private:
  int IndexOf(int index) const { return static_cast<int>(int64_t{index} * all_.size() / size()); }
  const RefinementPhotoSource& all_;
};

}  // namespace

std::optional<double> TexturedShare(const RefinementPhotoSource& photos,
                                    const std::vector<uint32_t>& vertices,
                                    const MeshRefinementOptions& options, const TriangleMesh& mesh,
                                    Reporter& reporter) {
  if (vertices.empty() || mesh.triangles.empty()) return std::nullopt;
  const int num_threads = NumThreadsOf(options.num_threads);
  RefinementPhotos chosen(num_threads, reporter);
  chosen.Load(EvenlyChosen(photos), mesh, options.max_memory_gib);
  const std::vector<VertexFlags> visible = chosen.FindVisible(mesh, {kMinSeenCosine, kPatchSide / 2});
  const size_t count = std::min(kMaxVertices, vertices.size());
  std::vector<uint8_t> is_seen(count, 0);
  std::vector<uint8_t> has_texture(count, 0);
  ParallelFor(static_cast<int64_t>(count), num_threads, 16, [&](int64_t i) {
    const uint32_t vertex = vertices[static_cast<size_t>(i) * vertices.size() / count];
    SurfacePatch patch = chosen.PatchAt(mesh, vertex, visible, kViews);
    if (patch.num_views < kLeastPhotosCompared) return;
    patch.LayFlat(0);
    is_seen[i] = 1;
    has_texture[i] = MeasureAgreement(patch).texture > kLeastTexture ? 1 : 0;
  });
  const auto num_seen = std::count(is_seen.begin(), is_seen.end(), 1);
  if (num_seen == 0) return std::nullopt;
  return static_cast<double>(std::count(has_texture.begin(), has_texture.end(), 1)) /
         static_cast<double>(num_seen);
}

}  // namespace s2gs
