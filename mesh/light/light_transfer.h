#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "mesh/surface/triangle_mesh.h"

namespace s2gs {

/// Spherical harmonics of bands 0 to 3, in the order and with the signs of s2gs/kernel/sh.h.
constexpr int kLightTerms = 16;
using LightTerms = Eigen::Matrix<float, kLightTerms, 1>;

/// How light that comes from far away reaches a surface that shadows itself: for each place, what each
/// harmonic of the light adds to the light that arrives there, the integral of harmonic x cosine x visibility
/// over all directions (Sloan, Kautz and Snyder, "Precomputed radiance transfer", SIGGRAPH 2002; diffuse,
/// without light that is reflected from one part to another).
class LightTransfer {
 public:
  LightTransfer() = default;
  /// \param mesh  with normals, which is not kept.
  LightTransfer(const TriangleMesh& mesh, int num_threads);

  /// At a place of a triangle, in the mesh's frame. \param u,v  barycentric, of the first and second corner.
  LightTerms At(uint32_t triangle, float u, float v) const;
  const LightTerms& AtVertex(size_t vertex) const { return values_[vertex]; }

 private:
  struct Point {
    Eigen::Vector3f x;
    Eigen::Vector3f normal;
  };
  void AddLattices(const TriangleMesh& mesh, double spacing, std::vector<Point>* points);

  std::vector<Triangle> triangles_;
  /// Large triangles have values on a lattice of their own, as shadows end within them: steps along an edge,
  /// 1 where the vertices' values do, and the first of its values.
  std::vector<uint16_t> steps_;
  std::vector<uint32_t> first_;
  std::vector<LightTerms> values_;  // of the vertices, then of the lattices
};

/// What each harmonic of the light adds to the light that arrives at a surface under an open sky, by its
/// normal of unit length. (Ramamoorthi and Hanrahan, "An efficient representation for irradiance environment
/// maps", SIGGRAPH 2001)
LightTerms OpenTransfer(const Eigen::Vector3f& normal);

/// All sixteen harmonics at a direction of unit length.
LightTerms LightHarmonics(const Eigen::Vector3f& direction);

}  // namespace s2gs
