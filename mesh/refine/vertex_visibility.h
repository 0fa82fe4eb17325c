#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "mesh/surface/object_view.h"
#include "mesh/surface/triangle_mesh.h"

namespace s2gs {

/// What counts as a view that sees a vertex.
struct VisibilityRule {
  float min_cosine = 0;  ///< between the vertex's normal and the direction to the camera.
  /// So far around the vertex the view must show nothing in front of it, nor any background [px]; 0: at the
  /// vertex alone, where background is as good as the vertex.
  int margin = 0;
};

/// One flag for each vertex.
class VertexFlags {
 public:
  explicit VertexFlags(size_t count = 0) : words_((count + 63) / 64) {}
  bool Get(size_t i) const { return (words_[i / 64] >> (i % 64) & 1U) != 0; }
  void Set(size_t i) { words_[i / 64] |= uint64_t{1} << (i % 64); }

 private:
  std::vector<uint64_t> words_;
};

/// Depths of the mesh's nearest surface at the pixels' centres, infinite where there is none. Triangles that
/// reach behind the camera are left out.
/// \param triangle_at  may be null; which triangle it is at each pixel, -1 where there is none.
std::vector<float> RenderMeshDepth(const TriangleMesh& mesh, const ObjectView& view,
                                   std::vector<int32_t>* triangle_at = nullptr);

/// Which triangle each pixel's centre shows, row by row: -1 where it shows none.
struct ShownTriangles {
  std::vector<int32_t> of_kept;  ///< of those that are kept alone
  std::vector<int32_t> of_all;
};
/// \param keep  of each triangle.
ShownTriangles FindShownTriangles(const TriangleMesh& mesh, const std::vector<bool>& keep,
                                  const ObjectView& view);

/// Which vertices the view sees: those within the image that the mesh itself does not hide.
/// \param mesh  with normals.
VertexFlags FindVisibleVertices(const TriangleMesh& mesh, const ObjectView& view, const VisibilityRule& rule);

}  // namespace s2gs
