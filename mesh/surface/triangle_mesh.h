#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <istream>
#include <ostream>
#include <vector>

#include "sfm_split/scene/io/ply_file.h"

namespace s2gs {

/// Vertex indices, counter-clockwise seen from outside.
using Triangle = Eigen::Matrix<uint32_t, 3, 1>;

/// A triangle mesh with shared vertices. A mesh without triangles is a point cloud.
struct TriangleMesh {
  std::vector<Eigen::Vector3f> vertices;             ///< in the frame and unit of whoever made the mesh.
  std::vector<Eigen::Vector3f> normals;              ///< one per vertex, or empty.
  std::vector<Eigen::Matrix<uint8_t, 3, 1>> colors;  ///< RGB, one per vertex, or empty.
  std::vector<Triangle> triangles;
  std::vector<PlyProperty> extra_vertex_properties = {};  ///< further columns of a file, one row per vertex.
};

/// Reads the elements "vertex" (x, y, z; nx, ny, nz and red, green, blue when all three are there; colours as
/// uchar, or as float or double from 0 to 1) and "face" (list vertex_indices or vertex_index) of a PLY file.
/// Polygons become triangle fans. Other properties of "vertex" are kept, everything else is dropped.
/// Throws UserError with the path for damaged files, vertices that are not finite, indices beyond the
/// vertices and faces of fewer than three corners.
/// \param path  for the stream form: for messages only.
TriangleMesh ReadPlyMesh(const std::filesystem::path& path);
TriangleMesh ReadPlyMesh(std::istream& stream, const std::filesystem::path& path);

/// Writes x, y, z, the normals and nx, ny, nz as float, colours as uchar, the extra properties, and faces as
/// `list uchar int vertex_indices` (uint past 2^31 vertices). The path form is atomic.
void WritePlyMesh(const std::filesystem::path& path, const TriangleMesh& mesh,
                  PlyFormat format = PlyFormat::kBinaryLittleEndian);
void WritePlyMesh(std::ostream& stream, const TriangleMesh& mesh,
                  PlyFormat format = PlyFormat::kBinaryLittleEndian);

}  // namespace s2gs
