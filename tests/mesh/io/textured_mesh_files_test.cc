#include "mesh/io/textured_mesh_files.h"

#include <gtest/gtest.h>

#include <cstring>
#include <fstream>
#include <nlohmann/json.hpp>
#include <set>
#include <sstream>
#include <string>
#include <vector>

#include "s2gs/image/image_file.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/scene/io/ply_file.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

// Two pages of different sizes, a triangle and a square.
TexturedMesh TwoPages() {
  TexturedMesh mesh;
  mesh.vertices = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {2, 0, 0.5F}, {3, 0, 0.5F}, {3, 1, 0.5F}, {2, 1, 0.5F}};
  mesh.normals.assign(7, Eigen::Vector3f(0, 0, 1));
  mesh.texels = {{1.5F, 2.5F},  {6.5F, 2.5F}, {1.5F, 3.5F}, {0.5F, 0.5F},
                 {15.5F, 0.5F}, {15.5F, 9},   {0.5F, 9}};
  mesh.triangles = {{0, 1, 2}, {3, 4, 5}, {3, 5, 6}};
  Image8 first{8, 4, 3, std::vector<uint8_t>(96)};
  Image8 second{16, 10, 3, std::vector<uint8_t>(480)};
  for (size_t i = 0; i < first.pixels.size(); ++i) first.pixels[i] = static_cast<uint8_t>(2 * i);
  for (size_t i = 0; i < second.pixels.size(); ++i) second.pixels[i] = static_cast<uint8_t>(7 * i);
  mesh.pages = {{first, 0, 1}, {second, 1, 2}};
  return mesh;
}

// Places in the page from 0 to 1, downwards, of each triangle's corners.
std::vector<Eigen::Vector2f> ExpectedCorners(const TexturedMesh& mesh) {
  std::vector<Eigen::Vector2f> corners;
  for (size_t t = 0; t < mesh.triangles.size(); ++t) {
    const Image8& page = mesh.pages[t == 0 ? 0 : 1].image;
    for (int i = 0; i < 3; ++i) {
      const Eigen::Vector2f& texel = mesh.texels[mesh.triangles[t][i]];
      corners.emplace_back(texel.x() / static_cast<float>(page.width),
                           texel.y() / static_cast<float>(page.height));
    }
  }
  return corners;
}

void ExpectNear(const Eigen::Vector2f& a, const Eigen::Vector2f& b) { EXPECT_LT((a - b).norm(), 1e-6F); }

TEST(TexturedMeshFiles, ObjNamesItsMaterialsAndPages) {
  const TemporaryFolder folder;
  const TexturedMesh mesh = TwoPages();
  WriteTexturedMesh(folder.path() / "a.b", mesh);
  std::ifstream stream(folder.path() / "a.b.obj");
  std::vector<Eigen::Vector3f> vertices;
  std::vector<Eigen::Vector2f> uvs;
  std::vector<Eigen::Vector2f> corners;
  std::vector<Eigen::Vector3f> corner_vertices;
  std::vector<std::string> materials;
  std::string library;
  for (std::string line; std::getline(stream, line);) {
    std::istringstream words(line);
    std::string keyword;
    words >> keyword;
    if (keyword == "mtllib") words >> library;
    if (keyword == "v") {
      Eigen::Vector3f v;
      words >> v.x() >> v.y() >> v.z();
      vertices.push_back(v);
    }
    if (keyword == "vt") {
      Eigen::Vector2f uv;
      words >> uv.x() >> uv.y();
      uvs.emplace_back(uv.x(), 1 - uv.y());
    }
    if (keyword == "usemtl") materials.push_back(line.substr(7));
    if (keyword == "f") {
      for (std::string corner; words >> corner;) {
        size_t v = 0, vt = 0, vn = 0;
        ASSERT_EQ(std::sscanf(corner.c_str(), "%zu/%zu/%zu", &v, &vt, &vn), 3);
        corner_vertices.push_back(vertices.at(v - 1));
        corners.push_back(uvs.at(vt - 1));
      }
    }
  }
  const std::vector<Eigen::Vector2f> expected = ExpectedCorners(mesh);
  ASSERT_EQ(corners.size(), expected.size());
  for (size_t i = 0; i < corners.size(); ++i) {
    ExpectNear(corners[i], expected[i]);
    EXPECT_EQ(corner_vertices[i], mesh.vertices[mesh.triangles[i / 3][static_cast<int>(i % 3)]]);
  }
  EXPECT_EQ(library, "a.b.mtl");
  const std::string mtl = ReadWholeFile(folder.path() / library, 1 << 20);
  for (size_t page = 0; page < 2; ++page) {
    EXPECT_NE(mtl.find("newmtl " + materials.at(page) + "\n"), std::string::npos);
    EXPECT_NE(mtl.find("map_Kd a.b_" + std::to_string(page) + ".png\n"), std::string::npos);
    EXPECT_EQ(ReadImage(TexturePagePath(folder.path() / "a.b", page), 3).pixels,
              mesh.pages[page].image.pixels);
  }
}

TEST(TexturedMeshFiles, PlyHasPlacesForVerticesAndFaces) {
  const TemporaryFolder folder;
  const TexturedMesh mesh = TwoPages();
  WriteTexturedMesh(folder.path() / "a", mesh);
  const PlyFile ply = ReadPly(folder.path() / "a.ply");
  EXPECT_EQ(ply.comments, (std::vector<std::string>{"TextureFile a_0.png", "TextureFile a_1.png"}));
  const auto s = PlyFloats(ply.Find("vertex")->Find("s")->values);
  const auto t = PlyFloats(ply.Find("vertex")->Find("t")->values);
  const auto texcoords = PlyFloats(ply.Find("face")->Find("texcoord")->values);
  const auto pages = PlyFloats(ply.Find("face")->Find("texnumber")->values);
  EXPECT_EQ(pages, (std::vector<float>{0, 1, 1}));
  const std::vector<Eigen::Vector2f> expected = ExpectedCorners(mesh);
  ASSERT_EQ(texcoords.size(), 2 * expected.size());
  for (size_t i = 0; i < expected.size(); ++i) {
    const uint32_t v = mesh.triangles[i / 3][static_cast<int>(i % 3)];
    ExpectNear({s[v], 1 - t[v]}, expected[i]);
    ExpectNear({texcoords[2 * i], 1 - texcoords[2 * i + 1]}, expected[i]);
  }
}

TEST(TexturedMeshFiles, GlbIsOneFileWithAllPages) {
  const TemporaryFolder folder;
  const TexturedMesh mesh = TwoPages();
  WriteTexturedMesh(folder.path() / "a", mesh);
  const std::string bytes = ReadWholeFile(folder.path() / "a.glb", 1 << 20);
  uint32_t words[5];
  std::memcpy(words, bytes.data(), sizeof(words));
  EXPECT_EQ(words[0], 0x46546C67u);
  EXPECT_EQ(words[1], 2u);
  ASSERT_EQ(words[2], bytes.size());
  const nlohmann::json gltf = nlohmann::json::parse(bytes.substr(20, words[3]));
  const std::string buffer = bytes.substr(28 + words[3]);
  EXPECT_EQ(buffer.size(), gltf.at("buffers").at(0).at("byteLength").get<size_t>());
  const auto view_bytes = [&](size_t view) {
    const nlohmann::json& v = gltf.at("bufferViews").at(view);
    EXPECT_EQ(v.at("byteOffset").get<size_t>() % 4, 0u);
    return buffer.substr(v.at("byteOffset"), v.at("byteLength"));
  };
  const std::vector<Eigen::Vector2f> expected = ExpectedCorners(mesh);
  size_t corner = 0;
  const nlohmann::json& primitives = gltf.at("meshes").at(0).at("primitives");
  ASSERT_EQ(primitives.size(), 2u);
  for (size_t page = 0; page < 2; ++page) {
    const nlohmann::json& primitive = primitives.at(page);
    const nlohmann::json& uv_accessor =
        gltf.at("accessors").at(primitive.at("attributes").at("TEXCOORD_0").get<size_t>());
    const std::string uvs = view_bytes(uv_accessor.at("bufferView"));
    const nlohmann::json& index_accessor = gltf.at("accessors").at(primitive.at("indices").get<size_t>());
    const std::string indices = view_bytes(index_accessor.at("bufferView"));
    for (size_t i = 0; i < index_accessor.at("count").get<size_t>(); ++i, ++corner) {
      uint32_t v = 0;
      std::memcpy(&v, indices.data() + 4 * i, 4);
      EXPECT_EQ(v, mesh.triangles[corner / 3][static_cast<int>(corner % 3)]);
      Eigen::Vector2f uv;
      std::memcpy(uv.data(), uvs.data() + 8 * v, 8);
      ExpectNear(uv, expected[corner]);  // the format's origin is the top left, too
    }
    const nlohmann::json& material = gltf.at("materials").at(primitive.at("material").get<size_t>());
    const nlohmann::json& pbr = material.at("pbrMetallicRoughness");
    EXPECT_EQ(pbr.at("metallicFactor"), 0);
    const nlohmann::json& texture =
        gltf.at("textures").at(pbr.at("baseColorTexture").at("index").get<size_t>());
    const nlohmann::json& image = gltf.at("images").at(texture.at("source").get<size_t>());
    EXPECT_EQ(image.at("mimeType"), "image/png");
    EXPECT_FALSE(image.contains("uri"));
    const Image8 decoded = DecodeImage(view_bytes(image.at("bufferView")), "a.glb", 3);
    EXPECT_EQ(decoded.pixels, mesh.pages[page].image.pixels);
  }
  EXPECT_EQ(corner, expected.size());
}

TEST(TexturedMeshFiles, PagesOfALargerTextureGo) {
  const TemporaryFolder folder;
  TexturedMesh mesh = TwoPages();
  WriteTexturedMesh(folder.path() / "a", mesh);
  ASSERT_TRUE(fs::exists(folder.path() / "a_1.png"));
  mesh.pages.pop_back();
  mesh.triangles.resize(1);
  WriteTexturedMesh(folder.path() / "a", mesh);
  EXPECT_TRUE(fs::exists(folder.path() / "a_0.png"));
  EXPECT_FALSE(fs::exists(folder.path() / "a_1.png"));
  EXPECT_THROW(WriteTexturedMesh(folder.path() / "missing" / "a", mesh), UserError);
  EXPECT_THROW(WriteTexturedMesh(folder.path() / "a", TexturedMesh()), UserError);
}

}  // namespace
}  // namespace s2gs
