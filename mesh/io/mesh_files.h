#pragma once

#include <filesystem>
#include <ostream>

#include "mesh/surface/triangle_mesh.h"

namespace s2gs {

/// Writes by the extension: .ply, .obj or .glb, in either case. Atomic.
/// Throws UserError for other extensions and when the file cannot be written.
void WriteMesh(const std::filesystem::path& path, const TriangleMesh& mesh);

/// Throws UserError unless WriteMesh knows the extension.
void RequireMeshExtension(const std::filesystem::path& path);

/// Wavefront OBJ: positions (with colours after them, 0 to 1, as MeshLab and others read them), normals,
/// triangles. Numbers read back as the same floats and do not depend on the locale.
void WriteObjMesh(std::ostream& stream, const TriangleMesh& mesh);

/// glTF 2.0 in one binary file: positions, normals, colours, triangles as one mesh, in a node that turns z up
/// into glTF's y up. Colours are made linear, as the format wants them. Throws UserError for empty meshes and
/// for those beyond the format's 4 GiB. \param path  for messages only.
void WriteGlbMesh(std::ostream& stream, const TriangleMesh& mesh, const std::filesystem::path& path);

}  // namespace s2gs
