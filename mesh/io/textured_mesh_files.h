#pragma once

#include <filesystem>
#include <vector>

#include "mesh/surface/textured_mesh.h"

namespace s2gs {

/// Writes a textured mesh in the three forms that programs read, all at once or none:
///   BASE.obj with BASE.mtl,
///   BASE.glb: glTF 2.0 in one file, the pages as the base colours of rough materials; y up,
///   BASE.ply: places in the page for each vertex (s, t) and, for several pages, for each face (texcoord,
///             texnumber), as Blender, MeshLab and Open3D read them;
/// and BASE_0.png, BASE_1.png and so on: the pages, which OBJ and PLY name.
/// \param base  the path without an extension.
/// \return  what was written. Throws UserError when a file cannot be written, or the mesh has no triangles.
std::vector<std::filesystem::path> WriteTexturedMesh(const std::filesystem::path& base,
                                                     const TexturedMesh& mesh);

/// The path of a page of WriteTexturedMesh.
std::filesystem::path TexturePagePath(const std::filesystem::path& base, size_t page);

}  // namespace s2gs
