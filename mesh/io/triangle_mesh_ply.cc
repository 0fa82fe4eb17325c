#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>
#include <utility>

#include "mesh/surface/triangle_mesh.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"

namespace s2gs {
namespace {

using Color = Eigen::Matrix<uint8_t, 3, 1>;
using Names = std::array<const char*, 3>;

constexpr Names kPosition = {"x", "y", "z"};
constexpr Names kNormal = {"nx", "ny", "nz"};
constexpr Names kColor = {"red", "green", "blue"};
constexpr char kRemedy[] = "The mesh is damaged or was written by an incompatible program";

// Takes the three scalar properties out of the element. Returns false, and takes none, unless all are there.
bool TakeTriple(PlyElement& element, const Names& names, std::array<PlyValues, 3>& columns) {
  std::array<PlyProperty*, 3> properties{};
  for (int i = 0; i < 3; ++i) {
    properties[i] = element.Find(names[i]);
    if (properties[i] == nullptr || properties[i]->is_list()) return false;
  }
  for (int i = 0; i < 3; ++i) columns[i] = std::move(properties[i]->values);
  auto& all = element.properties;
  all.erase(std::remove_if(all.begin(), all.end(),
                           [&](const PlyProperty& property) {
                             return std::find(names.begin(), names.end(), property.name) != names.end();
                           }),
            all.end());
  return true;
}

// Uses the columns up: millions of vertices need not stand in memory twice.
std::vector<Eigen::Vector3f> Vectors(std::array<PlyValues, 3>& columns, uint64_t count) {
  std::vector<Eigen::Vector3f> vectors(count);
  for (int i = 0; i < 3; ++i) {
    const std::vector<float> values = PlyFloats(std::move(columns[i]));
    for (size_t row = 0; row < count; ++row) vectors[row][i] = values[row];
  }
  return vectors;
}

bool IsColorType(const PlyProperty* property) {
  return property != nullptr &&
         (property->type() == PlyType::kUint8 || property->type() == PlyType::kFloat32 ||
          property->type() == PlyType::kFloat64);
}

uint8_t ColorFromUnit(float value) {
  if (!(value > 0)) return 0;
  return static_cast<uint8_t>(std::lround(std::min(value, 1.0F) * 255));
}

std::vector<Color> Colors(const std::array<PlyValues, 3>& columns, uint64_t count) {
  std::vector<Color> colors(count);
  for (int i = 0; i < 3; ++i) {
    if (const auto* bytes = std::get_if<std::vector<uint8_t>>(&columns[i])) {
      for (size_t row = 0; row < count; ++row) colors[row][i] = (*bytes)[row];
      continue;
    }
    const std::vector<float> values = PlyFloats(columns[i]);
    for (size_t row = 0; row < count; ++row) colors[row][i] = ColorFromUnit(values[row]);
  }
  return colors;
}

[[noreturn]] void FailAtFace(const std::filesystem::path& path, size_t face, const std::string& problem) {
  throw UserError(path, "face " + std::to_string(face) + " " + problem, kRemedy);
}

const PlyProperty& VertexIndices(const PlyElement& faces, const std::filesystem::path& path) {
  for (const char* name : {"vertex_indices", "vertex_index"}) {
    const PlyProperty* property = faces.Find(name);
    if (property != nullptr && property->is_list() && property->type() < PlyType::kFloat32) return *property;
  }
  throw UserError(path, "its element 'face' has no list of integers 'vertex_indices' or 'vertex_index'",
                  kRemedy);
}

template <typename Index>
std::vector<Triangle> FanTriangles(const std::vector<Index>& indices, const std::vector<uint64_t>& begins,
                                   uint64_t num_vertices, const std::filesystem::path& path) {
  std::vector<Triangle> triangles;
  triangles.reserve(begins.size() - 1);
  for (size_t face = 0; face + 1 < begins.size(); ++face) {
    const uint64_t begin = begins[face];
    const uint64_t end = begins[face + 1];
    if (end - begin < 3) FailAtFace(path, face, "has " + std::to_string(end - begin) + " corners");
    for (uint64_t i = begin; i < end; ++i) {
      // A negative index of a signed type is damage and must stay negative.
      const auto index = static_cast<int64_t>(indices[i]);  // NOLINT(bugprone-signed-char-misuse)
      if (index < 0 || static_cast<uint64_t>(index) >= num_vertices) {
        FailAtFace(
            path, face,
            "refers to vertex " + std::to_string(index) + ", but there are " + std::to_string(num_vertices));
      }
    }
    for (uint64_t i = begin + 1; i + 1 < end; ++i) {
      triangles.emplace_back(static_cast<uint32_t>(indices[begin]), static_cast<uint32_t>(indices[i]),
                             static_cast<uint32_t>(indices[i + 1]));
    }
  }
  return triangles;
}

template <typename Vectors>
void AddTriple(const Vectors& vectors, const Names& names, PlyElement& element) {
  using Scalar = typename Vectors::value_type::Scalar;
  for (int i = 0; i < 3; ++i) {
    std::vector<Scalar> column(vectors.size());
    for (size_t row = 0; row < vectors.size(); ++row) column[row] = vectors[row][i];
    element.AddColumn(names[i], std::move(column));
  }
}

template <typename Index>
PlyElement FaceElement(const std::vector<Triangle>& triangles) {
  std::vector<Index> indices;
  indices.reserve(3 * triangles.size());
  std::vector<uint64_t> begins = {0};
  begins.reserve(triangles.size() + 1);
  for (const Triangle& triangle : triangles) {
    for (int i = 0; i < 3; ++i) indices.push_back(static_cast<Index>(triangle[i]));
    begins.push_back(indices.size());
  }
  PlyElement faces;
  faces.name = "face";
  faces.num_rows = triangles.size();
  faces.properties.push_back({"vertex_indices", std::move(indices), PlyType::kUint8, std::move(begins)});
  return faces;
}

PlyFile MeshFile(const TriangleMesh& mesh, PlyFormat format) {
  const size_t num_vertices = mesh.vertices.size();
  S2GS_INVARIANT(mesh.normals.empty() || mesh.normals.size() == num_vertices);
  S2GS_INVARIANT(mesh.colors.empty() || mesh.colors.size() == num_vertices);
  S2GS_INVARIANT(num_vertices <= std::numeric_limits<uint32_t>::max());
  for (const Triangle& triangle : mesh.triangles) S2GS_INVARIANT(triangle.maxCoeff() < num_vertices);

  PlyFile file;
  file.format = format;
  PlyElement vertices;
  vertices.name = "vertex";
  vertices.num_rows = num_vertices;
  AddTriple(mesh.vertices, kPosition, vertices);
  if (!mesh.normals.empty()) AddTriple(mesh.normals, kNormal, vertices);
  if (!mesh.colors.empty()) AddTriple(mesh.colors, kColor, vertices);
  for (const PlyProperty& property : mesh.extra_vertex_properties) {
    // Half a normal, say, that was kept as an extra before the whole one was computed.
    if (vertices.Find(property.name) == nullptr) vertices.properties.push_back(property);
  }
  file.elements.push_back(std::move(vertices));
  const bool fits_int = num_vertices <= static_cast<size_t>(std::numeric_limits<int32_t>::max());
  file.elements.push_back(fits_int ? FaceElement<int32_t>(mesh.triangles)
                                   : FaceElement<uint32_t>(mesh.triangles));
  return file;
}

}  // namespace

TriangleMesh ReadPlyMesh(std::istream& stream, const std::filesystem::path& path) {
  PlyFile file = ReadPly(stream, path);
  PlyElement* vertices = file.Find("vertex");
  if (vertices == nullptr) throw UserError(path, "has no element 'vertex'", kRemedy);
  const uint64_t num_vertices = vertices->num_rows;
  if (num_vertices > std::numeric_limits<uint32_t>::max()) {
    throw UserError(path, "has more than 2^32 vertices", "Split the mesh");
  }
  for (const char* name : kPosition) RequirePlyScalar(*vertices, name, path);

  TriangleMesh mesh;
  std::array<PlyValues, 3> columns;
  TakeTriple(*vertices, kPosition, columns);
  mesh.vertices = Vectors(columns, num_vertices);
  for (size_t row = 0; row < num_vertices; ++row) {
    if (!mesh.vertices[row].allFinite()) {
      throw UserError(path, "vertex " + std::to_string(row) + " is not finite", kRemedy);
    }
  }
  if (TakeTriple(*vertices, kNormal, columns)) mesh.normals = Vectors(columns, num_vertices);
  const bool has_colors = std::all_of(kColor.begin(), kColor.end(),
                                      [&](const char* name) { return IsColorType(vertices->Find(name)); });
  if (has_colors && TakeTriple(*vertices, kColor, columns)) mesh.colors = Colors(columns, num_vertices);
  mesh.extra_vertex_properties = std::move(vertices->properties);

  if (const PlyElement* faces = file.Find("face"); faces != nullptr && faces->num_rows > 0) {
    const PlyProperty& indices = VertexIndices(*faces, path);
    mesh.triangles = std::visit(
        [&](const auto& values) { return FanTriangles(values, indices.list_begins, num_vertices, path); },
        indices.values);
  } else if (file.Find("tristrips") != nullptr) {
    throw UserError(path, "holds triangle strips instead of faces", "Convert it to a mesh of faces first");
  }
  return mesh;
}

TriangleMesh ReadPlyMesh(const std::filesystem::path& path) {
  std::ifstream stream = OpenForReading(path);
  return ReadPlyMesh(stream, path);
}

void WritePlyMesh(std::ostream& stream, const TriangleMesh& mesh, PlyFormat format) {
  WritePly(stream, MeshFile(mesh, format));
}

void WritePlyMesh(const std::filesystem::path& path, const TriangleMesh& mesh, PlyFormat format) {
  const PlyFile file = MeshFile(mesh, format);
  WriteFileAtomically(path, [&](std::ostream& stream) { WritePly(stream, file); });
}

}  // namespace s2gs
