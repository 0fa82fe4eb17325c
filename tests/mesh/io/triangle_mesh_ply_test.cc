#include <gtest/gtest.h>

#include <filesystem>
#include <limits>
#include <sstream>
#include <string>

#include "mesh/surface/triangle_mesh.h"
#include "tests/support/bad_input.h"

namespace s2gs {
namespace {

using Triangle = Eigen::Matrix<uint32_t, 3, 1>;
using Color = Eigen::Matrix<uint8_t, 3, 1>;

TriangleMesh Parse(const std::string& bytes) {
  std::istringstream stream(bytes);
  return ReadPlyMesh(stream, "a.ply");
}

std::string Print(const TriangleMesh& mesh, PlyFormat format) {
  std::ostringstream stream;
  WritePlyMesh(stream, mesh, format);
  return stream.str();
}

TriangleMesh Tetrahedron() {
  TriangleMesh mesh;
  mesh.vertices = {{0, 0, 0}, {.1F, 0, 0}, {0, 1e-20F, 0}, {0, 0, -3}};
  mesh.triangles = {{0, 2, 1}, {0, 1, 3}, {1, 2, 3}, {2, 0, 3}};
  return mesh;
}

constexpr PlyFormat kFormats[] = {PlyFormat::kAscii, PlyFormat::kBinaryLittleEndian,
                                  PlyFormat::kBinaryBigEndian};

TEST(TriangleMeshPly, WritesTheTextExpected) {
  TriangleMesh mesh = Tetrahedron();
  mesh.colors.assign(4, {1, 2, 255});
  EXPECT_EQ(Print(mesh, PlyFormat::kAscii),
            "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
            "property uchar red\nproperty uchar green\nproperty uchar blue\nelement face 4\n"
            "property list uchar int vertex_indices\nend_header\n"
            "0 0 0 1 2 255\n0.1 0 0 1 2 255\n0 1e-20 0 1 2 255\n0 0 -3 1 2 255\n"
            "3 0 2 1\n3 0 1 3\n3 1 2 3\n3 2 0 3\n");
}

TEST(TriangleMeshPly, RoundTripInEveryFormat) {
  TriangleMesh mesh = Tetrahedron();
  for (int part = 0; part < 4; ++part) {
    if (part == 1) mesh.normals.assign(4, {0, .6F, -.8F});
    if (part == 2) mesh.colors.assign(4, {0, 128, 255});
    if (part == 3) {
      mesh.extra_vertex_properties.push_back({"quality", std::vector<double>{.1, .2, .3, .4}, {}, {}});
      mesh.extra_vertex_properties.push_back({"alpha", std::vector<uint8_t>{0, 1, 2, 255}, {}, {}});
      mesh.extra_vertex_properties.push_back(
          {"neighbours", std::vector<int32_t>{5, 6}, PlyType::kUint8, {0, 0, 2, 2, 2}});
    }
    for (const PlyFormat format : kFormats) {
      const TriangleMesh read = Parse(Print(mesh, format));
      EXPECT_EQ(read.vertices, mesh.vertices);
      EXPECT_EQ(read.normals, mesh.normals);
      EXPECT_EQ(read.colors, mesh.colors);
      EXPECT_EQ(read.triangles, mesh.triangles);
      ASSERT_EQ(read.extra_vertex_properties.size(), mesh.extra_vertex_properties.size());
      for (size_t i = 0; i < read.extra_vertex_properties.size(); ++i) {
        EXPECT_EQ(read.extra_vertex_properties[i].name, mesh.extra_vertex_properties[i].name);
        EXPECT_EQ(read.extra_vertex_properties[i].values, mesh.extra_vertex_properties[i].values);
        EXPECT_EQ(read.extra_vertex_properties[i].list_begins, mesh.extra_vertex_properties[i].list_begins);
      }
    }
  }
}

TEST(TriangleMeshPly, FileRoundTripAndEmptyMesh) {
  const std::filesystem::path path =
      std::filesystem::path(testing::TempDir()) / "s2gs_triangle_mesh_test.ply";
  WritePlyMesh(path, Tetrahedron());
  EXPECT_EQ(ReadPlyMesh(path).triangles, Tetrahedron().triangles);
  WritePlyMesh(path, {});
  EXPECT_TRUE(ReadPlyMesh(path).vertices.empty());
  std::filesystem::remove(path);
  ExpectUserError([&] { ReadPlyMesh(path); }, {path.string(), "no such file"});
}

TEST(TriangleMeshPly, ReadsPolygonsDoublesAndFloatColors) {
  const TriangleMesh mesh = Parse(
      "ply\nformat ascii 1.0\nelement vertex 5\nproperty double x\nproperty double y\nproperty double z\n"
      "property float red\nproperty float green\nproperty float blue\nelement face 2\n"
      "property uchar flags\nproperty list ushort ushort vertex_index\nelement edge 1\nproperty int v\n"
      "end_header\n"
      "0.1 0 0 0 0.5 1\n1 0 0 -1 2 nan\n1 1 0 0 0 0\n0 1 0 0 0 0\n0 2 0 0 0 0\n9 3 4 3 2\n9 5 0 1 2 3 "
      "4\n1\n");
  EXPECT_EQ(mesh.vertices[0].x(), .1F);
  EXPECT_EQ(mesh.colors[0], Color(0, 128, 255));
  EXPECT_EQ(mesh.colors[1], Color(0, 255, 0));
  EXPECT_EQ(mesh.triangles, (std::vector<Triangle>{{4, 3, 2}, {0, 1, 2}, {0, 2, 3}, {0, 3, 4}}));
}

TEST(TriangleMeshPly, PartsOfTriplesAreKeptUntilTheyAreReplaced) {
  TriangleMesh mesh = Parse(
      "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
      "property float nx\nproperty int red\nproperty int green\nproperty int blue\nend_header\n1 2 3 4 5 6 "
      "7\n");
  EXPECT_TRUE(mesh.normals.empty());
  EXPECT_TRUE(mesh.colors.empty());
  EXPECT_EQ(mesh.extra_vertex_properties.size(), 4u);
  mesh.normals = {{0, 0, 1}};
  const TriangleMesh read = Parse(Print(mesh, PlyFormat::kAscii));
  EXPECT_EQ(read.normals, mesh.normals);
  EXPECT_EQ(read.extra_vertex_properties.size(), 3u);
}

TEST(TriangleMeshPlyBadInput, ContentThatIsNoMesh) {
  const std::string vertices =
      "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n";
  const std::string faces = vertices + "element face 1\nproperty list uchar ";
  const std::pair<std::string, const char*> cases[] = {
      {"ply\nformat ascii 1.0\nend_header\n", "no element 'vertex'"},
      {"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n", "'y'"},
      {vertices + "end_header\n0 nan 0\n", "vertex 0 is not finite"},
      {vertices + "element tristrips 1\nproperty int a\nend_header\n0 0 0\n1\n", "strips"},
      {faces + "int vertex_indices\nend_header\n0 0 0\n3 0 0 1\n", "face 0 refers to vertex 1"},
      {faces + "int vertex_indices\nend_header\n0 0 0\n3 0 0 -1\n", "face 0 refers to vertex -1"},
      {faces + "uint vertex_indices\nend_header\n0 0 0\n3 0 0 4294967295\n", "refers to vertex 4294967295"},
      {faces + "int vertex_indices\nend_header\n0 0 0\n2 0 0\n", "face 0 has 2 corners"},
      {faces + "float vertex_indices\nend_header\n0 0 0\n3 0 0 0\n", "vertex_index"},
      {faces + "int corners\nend_header\n0 0 0\n3 0 0 0\n", "vertex_index"},
  };
  for (const auto& [bytes, problem] : cases) {
    ExpectUserError([&, b = bytes] { Parse(b); }, {"a.ply", problem}, bytes);
  }
}

TEST(TriangleMeshPlyBadInput, EveryTruncationAndBitFlip) {
  TriangleMesh mesh = Tetrahedron();
  mesh.normals.assign(4, {0, 0, 1});
  mesh.colors.assign(4, {1, 2, 3});
  for (const PlyFormat format : kFormats) {
    const std::string bytes = Print(mesh, format);
    const ScopedAllocationLimit limit(16 * bytes.size());
    ForEachDamage(bytes, [&](const std::string& damaged, const std::string& description) {
      TriangleMesh read;
      if (!ExpectOkOrUserError([&] { read = Parse(damaged); }, "a.ply", description)) return;
      for (const Triangle& triangle : read.triangles) {
        EXPECT_LT(triangle.maxCoeff(), read.vertices.size()) << description;
      }
    });
  }
}

}  // namespace
}  // namespace s2gs
