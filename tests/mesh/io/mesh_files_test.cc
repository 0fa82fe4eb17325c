#include "mesh/io/mesh_files.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <vector>

#include "tests/support/bad_input.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

TriangleMesh Tetrahedron() {
  TriangleMesh mesh;
  mesh.vertices = {{0, 0, 0}, {.1F, 0, 0}, {0, 1e-20F, 0}, {0, 1.0F / 3, -3}};
  mesh.normals = {{0, 0, 1}, {0, 1, 0}, {.6F, 0, .8F}, {0, -1, 0}};
  mesh.colors = {{0, 0, 0}, {255, 128, 1}, {10, 20, 30}, {255, 255, 255}};
  mesh.triangles = {{0, 2, 1}, {0, 1, 3}, {1, 2, 3}, {2, 0, 3}};
  return mesh;
}

// A reader of its own for what the OBJ writer writes.
TriangleMesh ReadObj(const std::string& text) {
  TriangleMesh mesh;
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) {
    std::istringstream words(line);
    std::string keyword;
    words >> keyword;
    std::vector<std::string> rest;
    for (std::string word; words >> word;) rest.push_back(word);
    const auto number = [&](size_t i) { return std::stof(rest.at(i)); };
    if (keyword == "v") {
      mesh.vertices.emplace_back(number(0), number(1), number(2));
      if (rest.size() == 6) {
        Eigen::Matrix<uint8_t, 3, 1> color;
        for (size_t c = 0; c < 3; ++c) color[c] = static_cast<uint8_t>(std::lround(255 * number(3 + c)));
        mesh.colors.push_back(color);
      }
    } else if (keyword == "vn") {
      mesh.normals.emplace_back(number(0), number(1), number(2));
    } else if (keyword == "f") {
      Eigen::Matrix<uint32_t, 3, 1> triangle;
      for (size_t i = 0; i < 3; ++i) {
        triangle[i] = static_cast<uint32_t>(std::stoul(rest.at(i))) - 1;
        const size_t slashes = rest[i].find("//");
        if (slashes != std::string::npos) {
          EXPECT_EQ(std::stoul(rest[i].substr(slashes + 2)) - 1, triangle[i]);
        }
      }
      mesh.triangles.push_back(triangle);
    } else {
      ADD_FAILURE() << line;
    }
  }
  return mesh;
}

TEST(MeshFiles, ObjRoundTrip) {
  TriangleMesh mesh = Tetrahedron();
  for (int part = 0; part < 3; ++part) {
    if (part == 1) mesh.normals.clear();
    if (part == 2) mesh.colors.clear();
    std::ostringstream stream;
    WriteObjMesh(stream, mesh);
    const TriangleMesh read = ReadObj(stream.str());
    EXPECT_EQ(read.vertices, mesh.vertices);
    EXPECT_EQ(read.normals, mesh.normals);
    EXPECT_EQ(read.colors, mesh.colors);
    EXPECT_EQ(read.triangles, mesh.triangles);
  }
}

// Where other programs look for them: after the place, from 0 to 1.
TEST(MeshFiles, ObjHasColorsFromNullToOne) {
  TriangleMesh mesh = Tetrahedron();
  mesh.colors.assign(mesh.vertices.size(), {255, 0, 51});
  std::ostringstream stream;
  WriteObjMesh(stream, mesh);
  std::istringstream line(stream.str());
  std::string word;
  Eigen::Vector3d place, color;
  line >> word >> place.x() >> place.y() >> place.z() >> color.x() >> color.y() >> color.z();
  EXPECT_EQ(word, "v");
  EXPECT_LT((color - Eigen::Vector3d(1, 0, 0.2)).norm(), 1e-6);  // of a float's digits
}

uint32_t WordAt(const std::string& bytes, size_t offset) {
  uint32_t word = 0;
  std::memcpy(&word, bytes.data() + offset, sizeof(word));
  return word;
}

template <typename T>
std::vector<T> Values(const nlohmann::json& gltf, const std::string& buffer, size_t accessor, size_t width) {
  const nlohmann::json& description = gltf.at("accessors").at(accessor);
  const nlohmann::json& view = gltf.at("bufferViews").at(description.at("bufferView").get<size_t>());
  const auto count = description.at("count").get<size_t>() * width;
  EXPECT_EQ(view.at("byteLength").get<size_t>(), count * sizeof(T));
  const auto offset = view.at("byteOffset").get<size_t>();
  EXPECT_EQ(offset % 4, 0u);
  EXPECT_LE(offset + count * sizeof(T), buffer.size());
  std::vector<T> values(count);
  std::memcpy(values.data(), buffer.data() + offset, count * sizeof(T));
  return values;
}

TEST(MeshFiles, GlbFollowsTheFormat) {
  const TriangleMesh mesh = Tetrahedron();
  std::ostringstream stream;
  WriteGlbMesh(stream, mesh, "a.glb");
  const std::string bytes = stream.str();
  ASSERT_EQ(bytes.substr(0, 4), "glTF");
  EXPECT_EQ(WordAt(bytes, 4), 2u);
  EXPECT_EQ(WordAt(bytes, 8), bytes.size());
  const uint32_t json_size = WordAt(bytes, 12);
  EXPECT_EQ(json_size % 4, 0u);
  EXPECT_EQ(bytes.substr(16, 4), "JSON");
  const nlohmann::json gltf = nlohmann::json::parse(bytes.substr(20, json_size));
  EXPECT_EQ(WordAt(bytes, 20 + json_size), gltf.at("buffers").at(0).at("byteLength").get<uint32_t>());
  EXPECT_EQ(bytes.substr(24 + json_size, 4), std::string("BIN\0", 4));
  const std::string buffer = bytes.substr(28 + json_size);
  EXPECT_EQ(buffer.size(), gltf.at("buffers").at(0).at("byteLength").get<size_t>());

  EXPECT_EQ(gltf.at("asset").at("version"), "2.0");
  const nlohmann::json& node = gltf.at("nodes").at(gltf.at("scenes").at(0).at("nodes").at(0).get<size_t>());
  // The node's rotation takes our z to the format's y.
  const auto q = node.at("rotation").get<std::vector<double>>();
  const Eigen::Quaterniond rotation(q.at(3), q.at(0), q.at(1), q.at(2));
  EXPECT_LT((rotation * Eigen::Vector3d::UnitZ() - Eigen::Vector3d::UnitY()).norm(), 1e-12);
  const nlohmann::json& primitive = gltf.at("meshes").at(0).at("primitives").at(0);
  const nlohmann::json& attributes = primitive.at("attributes");
  const auto positions = Values<float>(gltf, buffer, attributes.at("POSITION").get<size_t>(), 3);
  const auto normals = Values<float>(gltf, buffer, attributes.at("NORMAL").get<size_t>(), 3);
  const auto colors = Values<uint16_t>(gltf, buffer, attributes.at("COLOR_0").get<size_t>(), 4);
  const auto indices = Values<uint32_t>(gltf, buffer, primitive.at("indices").get<size_t>(), 1);
  ASSERT_EQ(positions.size(), 12u);
  ASSERT_EQ(indices.size(), 12u);
  for (size_t v = 0; v < 4; ++v) {
    for (size_t i = 0; i < 3; ++i) {
      EXPECT_EQ(positions[3 * v + i], mesh.vertices[v][static_cast<int>(i)]);
      EXPECT_NEAR(normals[3 * v + i], mesh.normals[v][static_cast<int>(i)], 1e-6);
      const double linear = colors[4 * v + i] / 65535.0;
      const double srgb = linear <= 0.0031308 ? 12.92 * linear : 1.055 * std::pow(linear, 1 / 2.4) - 0.055;
      EXPECT_NEAR(255 * srgb, mesh.colors[v][static_cast<int>(i)], 0.1);
    }
    EXPECT_EQ(colors[4 * v + 3], 65535);
    for (size_t i = 0; i < 3; ++i) EXPECT_EQ(indices[3 * v + i], mesh.triangles[v][static_cast<int>(i)]);
  }
  const nlohmann::json& accessor = gltf.at("accessors").at(attributes.at("POSITION").get<size_t>());
  EXPECT_EQ(accessor.at("min"), (std::vector<float>{0, 0, -3}));
  EXPECT_EQ(accessor.at("max"), (std::vector<float>{.1F, 1.0F / 3, 0}));
}

TEST(MeshFiles, FormatByExtension) {
  const TemporaryFolder folder;
  for (const char* name : {"a.ply", "a.OBJ", "a.glb"}) WriteMesh(folder / name, Tetrahedron());
  EXPECT_EQ(ReadPlyMesh(folder / "a.ply").triangles, Tetrahedron().triangles);
  EXPECT_EQ(ReadObj(folder.Read("a.OBJ")).triangles, Tetrahedron().triangles);
  EXPECT_EQ(folder.Read("a.glb").substr(0, 4), "glTF");
  ExpectUserError([&] { WriteMesh(folder / "a.stl", Tetrahedron()); }, {"a.stl", ".glb"});
  ExpectUserError([&] { WriteMesh(folder / "b.glb", TriangleMesh()); }, {"b.glb", "empty"});
  EXPECT_FALSE(std::filesystem::exists(folder / "b.glb"));
}

}  // namespace
}  // namespace s2gs
