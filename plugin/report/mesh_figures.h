#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <vector>

#include "mesh/surface/mesh_cleanup.h"
#include "mesh/surface/object_view.h"
#include "mesh/surface/triangle_mesh.h"

namespace s2gs {

/// What a mesh measures, in the unit of its vertices.
struct MeshFigures {
  size_t num_vertices = 0;
  size_t num_triangles = 0;
  Eigen::Vector3d low = Eigen::Vector3d::Zero();  ///< of its bounding box.
  Eigen::Vector3d high = Eigen::Vector3d::Zero();
  double area = 0;
  double volume = 0;  ///< inside it, by the divergence theorem; of use only where there are no holes.
  size_t num_clusters = 0;
  struct Hole {
    size_t num_edges = 0;
    double length = 0;
  };
  std::vector<Hole> holes;  ///< the longest first.
};

MeshFigures MeasureMesh(const TriangleMesh& mesh);

/// In how many of the views each vertex is seen, less steep than 80 degrees and not hidden by the mesh.
/// Views are shrunk to 512 px, so that the mesh's edges are longer than their pixels.
std::vector<int> CountViewsOfVertices(const TriangleMesh& mesh, const std::vector<ObjectView>& views);

/// A mesh as the page's viewer takes it, each array in little-endian bytes.
struct PackedMesh {
  Eigen::Vector3f low = Eigen::Vector3f::Zero();  ///< coordinate = low + size * value / 65535.
  float size = 1;
  std::string positions;  ///< 3 uint16 a vertex.
  std::string colors;     ///< 3 uint8 a vertex; empty without colours.
  std::string views;      ///< uint8 a vertex, at most 255.
  std::string triangles;  ///< 3 indices a triangle: uint16, or uint32 past 65536 vertices.
  std::string holes;      ///< 2 indices an edge of a hole, likewise.
  int index_bytes = 2;
};

PackedMesh PackMesh(const TriangleMesh& mesh, const std::vector<int>& views,
                    const std::vector<MeshLoop>& holes);

}  // namespace s2gs
