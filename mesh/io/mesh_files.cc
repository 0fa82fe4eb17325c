#include "mesh/io/mesh_files.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <limits>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>
#include <vector>

#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"

namespace s2gs {
namespace {

std::string LowerExtension(const std::filesystem::path& path) {
  std::string extension = path.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return extension;
}

void CheckMesh(const TriangleMesh& mesh) {
  const size_t num_vertices = mesh.vertices.size();
  S2GS_INVARIANT(mesh.normals.empty() || mesh.normals.size() == num_vertices);
  S2GS_INVARIANT(mesh.colors.empty() || mesh.colors.size() == num_vertices);
}

template <typename Number>
void Append(Number value, std::string* text) {
  std::array<char, 32> buffer{};
  const auto [end, error] = std::to_chars(buffer.data(), buffer.data() + buffer.size(), value);
  S2GS_INVARIANT(error == std::errc());
  text->append(buffer.data(), end);
}

void AppendVector(std::string_view keyword, const Eigen::Vector3f& vector, std::string* text) {
  *text += keyword;
  for (int i = 0; i < 3; ++i) {
    *text += ' ';
    Append(vector[i], text);
  }
}

// Hands the text on now and then.
class TextSink {
 public:
  explicit TextSink(std::ostream& stream) : stream_(stream) {}
  std::string& text() { return text_; }
  void EndLine() {
    text_ += '\n';
    if (text_.size() < kChunk) return;
    Flush();
  }
  void Flush() {
    stream_.write(text_.data(), static_cast<std::streamsize>(text_.size()));
    text_.clear();
  }

 private:
  static constexpr size_t kChunk = 1 << 16;
  std::ostream& stream_;
  std::string text_;
};

void WriteWord(std::ostream& stream, uint64_t word) {
  std::array<char, 4> bytes{};
  for (size_t i = 0; i < bytes.size(); ++i) bytes[i] = static_cast<char>(word >> (8 * i) & 255U);
  stream.write(bytes.data(), bytes.size());
}

// glTF's component types and buffer targets.
constexpr int kUnsignedShort = 5123;
constexpr int kUnsignedInt = 5125;
constexpr int kFloat = 5126;
constexpr int kArrayBuffer = 34962;
constexpr int kElementArrayBuffer = 34963;

// The JSON part, and where the buffer's parts go.
class GlbDescription {
 public:
  GlbDescription() {
    json_["asset"] = {{"version", "2.0"}, {"generator", "s2gs"}};
    json_["scene"] = 0;
    json_["scenes"][0]["nodes"][0] = 0;
    json_["nodes"][0]["mesh"] = 0;
    // A quarter turn about x: (x, y, z) to (x, z, -y).
    json_["nodes"][0]["rotation"] = {-0.70710678118654752, 0, 0, 0.70710678118654752};
    // Without a material the format means polished metal.
    nlohmann::json& material = json_["materials"][0];
    material["pbrMetallicRoughness"] = {{"metallicFactor", 0}, {"roughnessFactor", 1}};
    material["doubleSided"] = true;
    json_["bufferViews"] = nlohmann::json::array();
    json_["accessors"] = nlohmann::json::array();
  }

  // Adds a part of the buffer and returns its accessor.
  size_t AddAccessor(uint64_t count, uint64_t bytes, int target, nlohmann::json accessor) {
    json_["bufferViews"].push_back(
        {{"buffer", 0}, {"byteOffset", num_bytes_}, {"byteLength", bytes}, {"target", target}});
    accessor["bufferView"] = json_["bufferViews"].size() - 1;
    accessor["count"] = count;
    json_["accessors"].push_back(std::move(accessor));
    num_bytes_ += bytes;
    return json_["accessors"].size() - 1;
  }

  uint64_t num_bytes() const { return num_bytes_; }

  std::string Text(const nlohmann::json& primitive) {
    json_["meshes"][0]["primitives"][0] = primitive;
    json_["buffers"][0]["byteLength"] = num_bytes_;
    std::string text = json_.dump();
    text.resize((text.size() + 3) / 4 * 4, ' ');
    return text;
  }

 private:
  nlohmann::json json_;
  uint64_t num_bytes_ = 0;
};

nlohmann::json Floats(const Eigen::Vector3f& vector) { return {vector.x(), vector.y(), vector.z()}; }

template <typename Vector>
void WriteArray(std::ostream& stream, const Vector& values) {
  stream.write(reinterpret_cast<const char*>(values.data()),
               static_cast<std::streamsize>(values.size() * sizeof(values[0])));
}

// The format's vertex colours are linear. (IEC 61966-2-1)
std::array<uint16_t, 256> LinearFromSrgb() {
  std::array<uint16_t, 256> linear{};
  for (size_t i = 0; i < linear.size(); ++i) {
    const double value = static_cast<double>(i) / 255;
    const double light = value <= 0.04045 ? value / 12.92 : std::pow((value + 0.055) / 1.055, 2.4);
    linear[i] = static_cast<uint16_t>(std::lround(65535 * light));
  }
  return linear;
}

// The format forbids normals that are not of unit length.
std::vector<Eigen::Vector3f> UnitNormals(const std::vector<Eigen::Vector3f>& normals) {
  std::vector<Eigen::Vector3f> unit;
  unit.reserve(normals.size());
  for (const Eigen::Vector3f& normal : normals) {
    const float norm = normal.norm();
    unit.emplace_back(norm > 0 ? Eigen::Vector3f(normal / norm) : Eigen::Vector3f(Eigen::Vector3f::UnitZ()));
  }
  return unit;
}

}  // namespace

void RequireMeshExtension(const std::filesystem::path& path) {
  const std::string extension = LowerExtension(path);
  if (extension == ".ply" || extension == ".obj" || extension == ".glb") return;
  throw UserError(path, "is no name for a mesh", "Choose one that ends in .ply, .obj or .glb");
}

void WriteMesh(const std::filesystem::path& path, const TriangleMesh& mesh) {
  RequireMeshExtension(path);
  const std::string extension = LowerExtension(path);
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
  TextSink sink(stream);
  for (size_t v = 0; v < mesh.vertices.size(); ++v) {
    AppendVector("v", mesh.vertices[v], &sink.text());
    if (!mesh.colors.empty()) {
      AppendVector("", mesh.colors[v].cast<float>() / 255.0F, &sink.text());
    }
    sink.EndLine();
  }
  for (const Eigen::Vector3f& normal : mesh.normals) {
    AppendVector("vn", normal, &sink.text());
    sink.EndLine();
  }
  for (const auto& triangle : mesh.triangles) {
    sink.text() += 'f';
    for (int i = 0; i < 3; ++i) {
      const uint64_t number = uint64_t{triangle[i]} + 1;
      sink.text() += ' ';
      Append(number, &sink.text());
      if (mesh.normals.empty()) continue;
      sink.text() += "//";
      Append(number, &sink.text());
    }
    sink.EndLine();
  }
  sink.Flush();
}

void WriteGlbMesh(std::ostream& stream, const TriangleMesh& mesh, const std::filesystem::path& path) {
  CheckMesh(mesh);
  const uint64_t num_vertices = mesh.vertices.size();
  const uint64_t num_triangles = mesh.triangles.size();
  GlbDescription description;
  if (num_vertices == 0 || num_triangles == 0) {
    throw UserError(path, "an empty mesh cannot be written in this format", "Write .ply");
  }
  nlohmann::json primitive = {{"mode", 4}, {"material", 0}};
  {
    Eigen::Vector3f low = mesh.vertices[0];
    Eigen::Vector3f high = low;
    for (const Eigen::Vector3f& vertex : mesh.vertices) {
      low = low.cwiseMin(vertex);
      high = high.cwiseMax(vertex);
    }
    primitive["attributes"]["POSITION"] = description.AddAccessor(
        num_vertices, 12 * num_vertices, kArrayBuffer,
        {{"componentType", kFloat}, {"type", "VEC3"}, {"min", Floats(low)}, {"max", Floats(high)}});
    if (!mesh.normals.empty()) {
      primitive["attributes"]["NORMAL"] = description.AddAccessor(
          num_vertices, 12 * num_vertices, kArrayBuffer, {{"componentType", kFloat}, {"type", "VEC3"}});
    }
    if (!mesh.colors.empty()) {
      primitive["attributes"]["COLOR_0"] = description.AddAccessor(
          num_vertices, 8 * num_vertices, kArrayBuffer,
          {{"componentType", kUnsignedShort}, {"type", "VEC4"}, {"normalized", true}});
    }
    primitive["indices"] = description.AddAccessor(3 * num_triangles, 12 * num_triangles, kElementArrayBuffer,
                                                   {{"componentType", kUnsignedInt}, {"type", "SCALAR"}});
  }
  const std::string text = description.Text(primitive);
  const uint64_t length = 12 + 8 + text.size() + 8 + description.num_bytes();
  if (length > std::numeric_limits<uint32_t>::max()) {
    throw UserError(path, "the mesh is too large for this format",
                    "Write .ply, or set a lower max_triangles");
  }
  WriteWord(stream, 0x46546C67);  // "glTF"
  WriteWord(stream, 2);
  WriteWord(stream, length);
  WriteWord(stream, text.size());
  WriteWord(stream, 0x4E4F534A);  // "JSON"
  stream << text;
  WriteWord(stream, description.num_bytes());
  WriteWord(stream, 0x004E4942);  // "BIN"
  WriteArray(stream, mesh.vertices);
  if (!mesh.normals.empty()) WriteArray(stream, UnitNormals(mesh.normals));
  const std::array<uint16_t, 256> linear = LinearFromSrgb();
  for (const auto& color : mesh.colors) {
    WriteWord(stream, linear[color[0]] | static_cast<uint64_t>(linear[color[1]]) << 16U);
    WriteWord(stream, linear[color[2]] | uint64_t{65535} << 16U);
  }
  WriteArray(stream, mesh.triangles);
}

}  // namespace s2gs
