#include "mesh/refine/offset_field.h"

#include <algorithm>
#include <utility>

#include "mesh/refine/conjugate_gradients.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {
namespace {

constexpr int64_t kGrain = 2048;  // vertices that a thread takes at a time; each is short work
}  // namespace

VertexGraph::VertexGraph(const TriangleMesh& mesh) {
  std::vector<uint64_t> edges;
  edges.reserve(6 * mesh.triangles.size());
  for (const auto& triangle : mesh.triangles) {
    for (int i = 0; i < 3; ++i) {
      const uint64_t a = triangle[i];
      const uint64_t b = triangle[(i + 1) % 3];
      if (a == b) continue;
      edges.push_back(a << 32U | b);
      edges.push_back(b << 32U | a);
    }
  }
  std::sort(edges.begin(), edges.end());
  edges.erase(std::unique(edges.begin(), edges.end()), edges.end());
  starts_.resize(mesh.vertices.size() + 1);
  neighbors_.reserve(edges.size());
  for (const uint64_t edge : edges) {
    ++starts_[(edge >> 32U) + 1];
    neighbors_.push_back(static_cast<uint32_t>(edge));
  }
  for (size_t i = 0; i + 1 < starts_.size(); ++i) starts_[i + 1] += starts_[i];
}

void GrowByNeighbors(const VertexGraph& graph, int rings, std::vector<uint8_t>* set) {
  S2GS_INVARIANT(set->size() == graph.size());
  for (int ring = 0; ring < rings; ++ring) {
    const std::vector<uint8_t> before = *set;
    for (size_t i = 0; i < before.size(); ++i) {
      if (before[i] == 0) continue;
      for (const uint32_t j : graph.Neighbors(i)) (*set)[j] = 1;
    }
  }
}

void AverageOverNeighbors(const VertexGraph& graph, const std::vector<uint8_t>& is_known, int width,
                          int rounds, int num_threads, std::vector<float>* rows) {
  S2GS_INVARIANT(is_known.size() == graph.size() && rows->size() == graph.size() * width);
  const auto count = static_cast<int64_t>(graph.size());
  std::vector<float> next(rows->size());
  for (int round = 0; round < rounds; ++round) {
    ParallelFor(count, num_threads, kGrain, [&](int64_t i) {
      float* mean = &next[i * width];
      std::copy_n(&(*rows)[i * width], width, mean);
      if (is_known[i] == 0) return;
      int num_rows = 1;
      for (const uint32_t neighbor : graph.Neighbors(i)) {
        if (is_known[neighbor] == 0) continue;
        const float* row = &(*rows)[static_cast<size_t>(neighbor) * width];
        for (int k = 0; k < width; ++k) mean[k] += row[k];
        ++num_rows;
      }
      for (int k = 0; k < width; ++k) mean[k] /= static_cast<float>(num_rows);
    });
    std::swap(*rows, next);
  }
}

std::vector<float> SmoothOffsets(const VertexGraph& graph, const std::vector<OffsetObservation>& observations,
                                 double smoothness, double prior, int num_threads) {
  S2GS_INVARIANT(observations.size() == graph.size());
  const auto count = static_cast<int64_t>(graph.size());
  std::vector<double> right(count);
  std::vector<double> diagonal(count);
  for (int64_t i = 0; i < count; ++i) {
    const double weight = observations[i].weight;
    right[i] = weight * observations[i].offset;
    diagonal[i] = weight + prior + smoothness * static_cast<double>(graph.Neighbors(i).size());
  }
  const auto multiply = [&](const std::vector<double>& x, std::vector<double>* image) {
    ParallelFor(count, num_threads, kGrain, [&](int64_t i) {
      double sum = (observations[i].weight + prior) * x[i];
      for (const uint32_t j : graph.Neighbors(i)) sum += smoothness * (x[i] - x[j]);
      (*image)[i] = sum;
    });
  };
  std::vector<float> offsets;
  offsets.reserve(count);
  for (const double value : SolveByConjugateGradients(multiply, diagonal, right))
    offsets.push_back(static_cast<float>(value));
  return offsets;
}

}  // namespace s2gs
