#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "mesh/surface/triangle_mesh.h"

namespace s2gs {

/// The grey value that one photo shows of a vertex.
struct ShadedSample {
  uint32_t vertex = 0;
  uint16_t photo = 0;
  float grey = 0;  ///< sRGB, from 0 to 255.
};

/// Normals of a mesh's vertices as their shading tells them.
struct ShadedNormals {
  std::vector<Eigen::Vector3f> normals;
  std::vector<float> sigma_rad;  ///< across the normal; 0: nothing is known, the mesh's own.
  double spread_rad = 0;         ///< of the mesh's normals about these, in each direction.
  double error_even = 0;         ///< of photos that the light was not fitted to [grey values, median].
  double error_lit = 0;          ///< the same under the light.
};

/// Photometric stereo of what turns under light that stands still (turn_light.h): each photo shows a place
/// under another light, so that its brightness over the photos tells how it leans, whatever its colour is.
/// First the light is found, by the mesh's own normals and shadows; then each vertex' normal and colour, by
/// robust least squares in grey values, about the mesh's normal as far as meshes lean by chance, which all
/// vertices tell together. A light of few numbers is wrong by degrees in places, but alike in neighbours.
/// Nothing (no normals) where the table does not turn or no light explains photos that are left out.
/// \param mesh               with normals.
/// \param smooth             the same without small forms, with normals: what shadows itself. Dents that are
/// noise shadow nothing.
/// \param does_judge         vertices at which photos that are left out judge the light.
/// \param samples            by vertex in ascending order; of a vertex by photo.
/// \param world_from_object  rotations of the photos.
/// \param num_threads        0: one for each core. The result does not depend on it.
ShadedNormals FindShadedNormals(const TriangleMesh& mesh, const TriangleMesh& smooth,
                                const std::vector<uint8_t>& does_judge,
                                const std::vector<ShadedSample>& samples,
                                const std::vector<Eigen::Matrix3d>& world_from_object, int num_threads);

}  // namespace s2gs
