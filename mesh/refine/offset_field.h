#pragma once

#include <cstdint>
#include <vector>

#include "mesh/surface/triangle_mesh.h"

namespace s2gs {

/// Neighbours of each vertex along the mesh's edges.
class VertexGraph {
 public:
  explicit VertexGraph(const TriangleMesh& mesh);

  size_t size() const { return starts_.size() - 1; }
  struct Range {
    const uint32_t* first;
    const uint32_t* last;
    const uint32_t* begin() const { return first; }
    const uint32_t* end() const { return last; }
    int64_t size() const { return last - first; }
  };
  Range Neighbors(size_t vertex) const {
    return {neighbors_.data() + starts_[vertex], neighbors_.data() + starts_[vertex + 1]};
  }

 private:
  std::vector<size_t> starts_;
  std::vector<uint32_t> neighbors_;
};

/// Takes `rings` rings of neighbours into a set of vertices.
void GrowByNeighbors(const VertexGraph& graph, int rings, std::vector<uint8_t>* set);

/// Replaces the rows of `is_known` vertices by the mean over them and their known neighbours, `rounds` times;
/// rows of the others stay as they are. \param rows  `width` values for each vertex.
void AverageOverNeighbors(const VertexGraph& graph, const std::vector<uint8_t>& is_known, int width,
                          int rounds, int num_threads, std::vector<float>* rows);

/// The field x of one value a vertex that is least in
///   sum_i w_i (x_i - o_i)^2 + prior sum_i x_i^2 + smoothness sum_edges (x_i - x_j)^2
/// by conjugate gradients. The result does not depend on the number of threads.
struct OffsetObservation {
  float offset = 0;  ///< o
  float weight = 0;  ///< w; 0: nothing is known.
};
std::vector<float> SmoothOffsets(const VertexGraph& graph, const std::vector<OffsetObservation>& observations,
                                 double smoothness, double prior, int num_threads);

}  // namespace s2gs
