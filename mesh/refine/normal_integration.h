#pragma once

#include <Eigen/Core>
#include <vector>

#include "mesh/refine/offset_field.h"
#include "mesh/surface/triangle_mesh.h"

namespace s2gs {

/// Normals that are told apart from the mesh's own.
struct ToldNormals {
  std::vector<Eigen::Vector3f> normals;  ///< of the vertices.
  std::vector<float> sigma_rad;          ///< in each direction across the normal; 0: not told.
  double spread_rad = 0;                 ///< of the mesh's normals about the true ones, likewise.
};

/// Each vertex at the mean of itself and its neighbours, so many times; with normals.
TriangleMesh Smoothed(const VertexGraph& graph, const TriangleMesh& mesh, int rounds, int num_threads);

/// Turns told normals so that over some rings of neighbours they lean on average as the mesh does: what errs
/// alike in neighbours goes, and what the mesh cannot tell from its noise stays. (Nehab, Rusinkiewicz, Davis
/// and Ramamoorthi, "Efficiently combining positions and normals for precise 3D geometry", SIGGRAPH 2005)
void LeanAsMesh(const VertexGraph& graph, const TriangleMesh& mesh, int num_threads, ToldNormals* told);

/// How far each vertex is to move along the mesh's normal: d is least in
///   sum_edges (n_ij . (x_j + d_j m_j - x_i - d_i m_i))^2 / (sigma_ij |x_j - x_i|)^2 + sum_i d_i^2 /
///   sigma_x^2
/// where m are the mesh's normals and n_ij is the mean of the told ones of an edge: the chord of a round
/// surface is at right angles to it. Where normals differ along an edge the surface may turn anywhere on it:
/// a twelfth of the difference's square adds to sigma_ij^2. sigma_i is the noise of the vertices' places that
/// makes a mesh's normals spread so, by the length of the edges there. By conjugate gradients; the result
/// does not depend on the number of threads.
std::vector<float> IntegrateNormals(const VertexGraph& graph, const TriangleMesh& mesh,
                                    const ToldNormals& told, int num_threads);

}  // namespace s2gs
