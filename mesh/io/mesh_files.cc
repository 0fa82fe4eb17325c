#include "mesh/io/mesh_files.h"

#include <array>
#include <cmath>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "mesh/io/glb_builder.h"
#include "mesh/io/glb_geometry.h"
#include "mesh/io/obj_text.h"
#include "s2gs/image/srgb.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/lower_case.h"

namespace s2gs {
namespace {

void CheckMesh(const TriangleMesh& mesh) {
  const size_t num_vertices = mesh.vertices.size();
  S2GS_INVARIANT(mesh.normals.empty() || mesh.normals.size() == num_vertices);
  S2GS_INVARIANT(mesh.colors.empty() || mesh.colors.size() == num_vertices);
}

// The format's vertex colours are linear.
std::array<uint16_t, 256> LinearFromSrgb() {
  std::array<uint16_t, 256> linear{};
  for (size_t i = 0; i < linear.size(); ++i) {
    linear[i] = static_cast<uint16_t>(std::lround(65535 * LightFromSrgb(static_cast<double>(i) / 255)));
  }
  return linear;
}

}  // namespace

void RequireMeshExtension(const std::filesystem::path& path) {
  const std::string extension = LowerCaseExtension(path);
  if (extension == ".ply" || extension == ".obj" || extension == ".glb") return;
  throw UserError(path, "is no name for a mesh", "Choose one that ends in .ply, .obj or .glb");
}

void WriteMesh(const std::filesystem::path& path, const TriangleMesh& mesh) {
  RequireMeshExtension(path);
  const std::string extension = LowerCaseExtension(path);
  if (extension == ".ply") {
    WritePlyMesh(path, mesh);
    return;
  }
  WriteFileAtomically(path, [&](std::ostream& stream) {
    if (extension == ".obj") {
      WriteObjMesh(stream, mesh);
    } else {
      WriteGlbMesh(stream, mesh, path);
    }
  });
}

void WriteObjMesh(std::ostream& stream, const TriangleMesh& mesh) {
  CheckMesh(mesh);
  ObjText sink(stream);
  for (size_t v = 0; v < mesh.vertices.size(); ++v) {
    AppendObjVector("v", mesh.vertices[v], &sink.text());
    if (!mesh.colors.empty()) {
      AppendObjVector("", mesh.colors[v].cast<float>() / 255.0F, &sink.text());
    }
    sink.EndLine();
  }
  for (const Eigen::Vector3f& normal : mesh.normals) {
    AppendObjVector("vn", normal, &sink.text());
    sink.EndLine();
  }
  for (const auto& triangle : mesh.triangles) {
    sink.text() += 'f';
    for (int i = 0; i < 3; ++i) {
      const uint64_t number = uint64_t{triangle[i]} + 1;
      sink.text() += ' ';
      AppendNumber(number, &sink.text());
      if (mesh.normals.empty()) continue;
      sink.text() += "//";
      AppendNumber(number, &sink.text());
    }
    sink.EndLine();
  }
  sink.Flush();
}

void WriteGlbMesh(std::ostream& stream, const TriangleMesh& mesh, const std::filesystem::path& path) {
  CheckMesh(mesh);
  const uint64_t num_vertices = mesh.vertices.size();
  const uint64_t num_triangles = mesh.triangles.size();
  if (num_vertices == 0 || num_triangles == 0) {
    throw UserError(path, "an empty mesh cannot be written in this format", "Write .ply");
  }
  GlbBuilder glb;
  // Without a material the format means polished metal.
  nlohmann::json& material = glb.json()["materials"][0];
  material["pbrMetallicRoughness"] = {{"metallicFactor", 0}, {"roughnessFactor", 1}};
  material["doubleSided"] = true;
  nlohmann::json primitive = {{"mode", 4}, {"material", 0}};
  AddGlbPositions(mesh.vertices, &glb, &primitive);
  if (!mesh.normals.empty()) AddGlbNormals(mesh.normals, &glb, &primitive);
  const std::array<uint16_t, 256> linear = LinearFromSrgb();
  if (!mesh.colors.empty()) {
    primitive["attributes"]["COLOR_0"] = glb.AddAccessor(
        num_vertices, 8 * num_vertices, kGlbArrayBuffer,
        {{"componentType", kGlbUnsignedShort}, {"type", "VEC4"}, {"normalized", true}},
        [&](std::ostream& out) {
          for (const auto& color : mesh.colors) {
            WriteGlbWord(out, linear[color[0]] | static_cast<uint64_t>(linear[color[1]]) << 16U);
            WriteGlbWord(out, linear[color[2]] | uint64_t{65535} << 16U);
          }
        });
  }
  AddGlbTriangles(mesh.triangles.data(), num_triangles, &glb, &primitive);
  glb.json()["meshes"][0]["primitives"][0] = primitive;
  glb.Write(stream, path);
}

}  // namespace s2gs
