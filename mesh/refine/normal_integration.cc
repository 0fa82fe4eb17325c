#include "mesh/refine/normal_integration.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "mesh/refine/conjugate_gradients.h"
#include "mesh/surface/vertex_normals.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {
namespace {

constexpr int kLeanRounds = 20;
constexpr int64_t kVerticesAtOnce = 2048;  // that a thread takes
// A plane through six neighbours at one distance e, each off by sigma, slopes by sigma / (sqrt(3) e).
constexpr double kNeighborsOfSlope = 3;

std::vector<Eigen::Vector3f> MeansOverNeighbors(const VertexGraph& graph,
                                                const std::vector<uint8_t>& is_known,
                                                const std::vector<Eigen::Vector3f>& vectors, int rounds,
                                                int num_threads) {
  std::vector<float> rows(3 * vectors.size());
  for (size_t i = 0; i < vectors.size(); ++i) std::copy_n(vectors[i].data(), 3, &rows[3 * i]);
  AverageOverNeighbors(graph, is_known, 3, rounds, num_threads, &rows);
  std::vector<Eigen::Vector3f> means;
  means.reserve(vectors.size());
  for (size_t i = 0; i < vectors.size(); ++i) means.emplace_back(&rows[3 * i]);
  return means;
}

// An edge from a vertex to one of its neighbours.
struct EdgeTerm {
  uint32_t other = 0;
  double own = 0;     // n . m of the vertex
  double across = 0;  // n . m of the neighbour
  double rise = 0;    // n . (x_j - x_i)
  double weight = 0;
};

}  // namespace

TriangleMesh Smoothed(const VertexGraph& graph, const TriangleMesh& mesh, int rounds, int num_threads) {
  TriangleMesh smooth;
  smooth.triangles = mesh.triangles;
  const std::vector<uint8_t> all(mesh.vertices.size(), 1);
  smooth.vertices = MeansOverNeighbors(graph, all, mesh.vertices, rounds, num_threads);
  ComputeNormals(&smooth);
  return smooth;
}

void LeanAsMesh(const VertexGraph& graph, const TriangleMesh& mesh, int num_threads, ToldNormals* told) {
  std::vector<uint8_t> is_told;
  is_told.reserve(told->sigma_rad.size());
  for (const float sigma : told->sigma_rad) is_told.push_back(sigma > 0 ? 1 : 0);
  const auto means = [&](const std::vector<Eigen::Vector3f>& normals) {
    return MeansOverNeighbors(graph, is_told, normals, kLeanRounds, num_threads);
  };
  const std::vector<Eigen::Vector3f> of_mesh = means(mesh.normals);
  const std::vector<Eigen::Vector3f> of_told = means(told->normals);
  ParallelFor(static_cast<int64_t>(graph.size()), num_threads, kVerticesAtOnce, [&](int64_t i) {
    if (is_told[i] == 0) return;
    const Eigen::Vector3f from = of_told[i].normalized();
    const Eigen::Vector3f to = of_mesh[i].normalized();
    told->normals[i] = (Eigen::Quaternionf::FromTwoVectors(from, to) * told->normals[i]).normalized();
  });
}

std::vector<float> IntegrateNormals(const VertexGraph& graph, const TriangleMesh& mesh,
                                    const ToldNormals& told, int num_threads) {
  S2GS_INVARIANT(told.normals.size() == graph.size() && told.sigma_rad.size() == graph.size());
  const auto count = static_cast<int64_t>(graph.size());
  std::vector<size_t> first(count + 1, 0);
  for (int64_t i = 0; i < count; ++i)
    first[i + 1] = first[i] + static_cast<size_t>(graph.Neighbors(i).size());
  std::vector<EdgeTerm> terms(first[count]);
  ParallelFor(count, num_threads, kVerticesAtOnce, [&](int64_t i) {
    size_t at = first[i];
    for (const uint32_t j : graph.Neighbors(i)) {
      EdgeTerm& term = terms[at++];
      term.other = j;
      if (!(told.sigma_rad[i] > 0 && told.sigma_rad[j] > 0)) continue;
      const Eigen::Vector3f normal = (told.normals[i] + told.normals[j]).normalized();
      const Eigen::Vector3f edge = mesh.vertices[j] - mesh.vertices[i];
      const double square = edge.squaredNorm();
      if (!(square > 0) || !normal.allFinite()) continue;
      const double turn = (told.normals[i] - told.normals[j]).squaredNorm();
      const double of_normals =
          (std::pow(told.sigma_rad[i], 2) + std::pow(told.sigma_rad[j], 2)) / 2 + turn / 12;
      term.own = normal.dot(mesh.normals[i]);
      term.across = normal.dot(mesh.normals[j]);
      term.rise = normal.dot(edge);
      term.weight = 1 / (of_normals * square);
    }
  });
  std::vector<float> offsets(count, 0);
  if (!(told.spread_rad > 0)) return offsets;
  const double held = 1 / (kNeighborsOfSlope * std::pow(told.spread_rad, 2));
  std::vector<double> right(count, 0);
  std::vector<double> hold(count);
  std::vector<double> diagonal(count);
  // Each edge stands at both of its ends.
  ParallelFor(count, num_threads, kVerticesAtOnce, [&](int64_t i) {
    double squares = 0;
    for (const uint32_t j : graph.Neighbors(i))
      squares += (mesh.vertices[j] - mesh.vertices[i]).squaredNorm();
    // A vertex without edges stays.
    hold[i] = squares > 0 ? held * static_cast<double>(graph.Neighbors(i).size()) / squares : 1;
    diagonal[i] = hold[i];
    for (size_t e = first[i]; e < first[i + 1]; ++e) {
      right[i] += terms[e].weight * terms[e].own * terms[e].rise;
      diagonal[i] += terms[e].weight * terms[e].own * terms[e].own;
    }
  });
  const auto multiply = [&](const std::vector<double>& x, std::vector<double>* image) {
    ParallelFor(count, num_threads, kVerticesAtOnce, [&](int64_t i) {
      double sum = hold[i] * x[i];
      for (size_t e = first[i]; e < first[i + 1]; ++e) {
        const EdgeTerm& term = terms[e];
        sum += term.weight * term.own * (term.own * x[i] - term.across * x[term.other]);
      }
      (*image)[i] = sum;
    });
  };
  const std::vector<double> solved = SolveByConjugateGradients(multiply, diagonal, right);
  std::transform(solved.begin(), solved.end(), offsets.begin(),
                 [](double value) { return static_cast<float>(value); });
  return offsets;
}

}  // namespace s2gs
