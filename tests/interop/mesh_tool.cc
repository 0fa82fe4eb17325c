// Writes one coloured mesh as mesh.ply, mesh.obj and mesh.glb, and its numbers as mesh.txt, for the test that
// other programs read these files; and the same with a texture as textured.ply, .obj and .glb, with
// textured.txt:  mesh_tool FOLDER

#include <cmath>
#include <cstdint>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <fstream>
#include <iomanip>

#include "mesh/io/mesh_files.h"
#include "mesh/io/textured_mesh_files.h"
#include "mesh/surface/vertex_normals.h"

namespace {

// A bent sheet of unequal sides, off the origin.
s2gs::TriangleMesh Example() {
  constexpr uint32_t kColumns = 13;
  constexpr uint32_t kRows = 7;
  s2gs::TriangleMesh mesh;
  for (uint32_t row = 0; row < kRows; ++row) {
    for (uint32_t column = 0; column < kColumns; ++column) {
      const double x = 0.1 * column + 3;
      const double y = 0.15 * row - 2;
      mesh.vertices.push_back(Eigen::Vector3d(x, y, 0.3 * std::sin(3 * x) * std::cos(2 * y)).cast<float>());
      mesh.colors.emplace_back(static_cast<uint8_t>(20 * column), static_cast<uint8_t>(40 * row),
                               static_cast<uint8_t>(255 - 3 * column * row));
    }
  }
  for (uint32_t row = 0; row + 1 < kRows; ++row) {
    for (uint32_t column = 0; column + 1 < kColumns; ++column) {
      const uint32_t corner = row * kColumns + column;
      mesh.triangles.emplace_back(corner, corner + 1, corner + kColumns);
      mesh.triangles.emplace_back(corner + 1, corner + kColumns + 1, corner + kColumns);
    }
  }
  s2gs::ComputeNormals(&mesh);
  return mesh;
}

// The same sheet; a texel of 6 x 5 pixels for each of its squares.
s2gs::TexturedMesh TexturedExample() {
  const s2gs::TriangleMesh sheet = Example();
  s2gs::TexturedMesh mesh;
  mesh.vertices = sheet.vertices;
  mesh.normals = sheet.normals;
  mesh.triangles = sheet.triangles;
  for (size_t i = 0; i < mesh.vertices.size(); ++i) {
    mesh.texels.emplace_back(4.5F + 6 * static_cast<float>(i % 13), 2.5F + 5 * static_cast<float>(i / 13));
  }
  s2gs::Image8 page{90, 40, 3, {}};
  for (int y = 0; y < page.height; ++y) {
    for (int x = 0; x < page.width; ++x) {
      for (const int value : {2 * x, 6 * y, x + y}) page.pixels.push_back(static_cast<uint8_t>(value));
    }
  }
  mesh.pages = {{page, 0, mesh.triangles.size()}};
  return mesh;
}

void WriteTextured(const std::filesystem::path& folder) {
  const s2gs::TexturedMesh mesh = TexturedExample();
  s2gs::WriteTexturedMesh(folder / "textured", mesh);
  std::ofstream text(folder / "textured.txt");
  text << std::setprecision(9) << mesh.vertices.size() << '\n';
  for (size_t i = 0; i < mesh.vertices.size(); ++i) {
    const int x = static_cast<int>(mesh.texels[i].x());
    const int y = static_cast<int>(mesh.texels[i].y());
    text << mesh.vertices[i].transpose() << ' ' << mesh.texels[i].transpose();
    for (int c = 0; c < 3; ++c) text << ' ' << int{mesh.pages[0].image.Pixel(x, y)[c]};
    text << '\n';
  }
  for (const auto& triangle : mesh.triangles) text << triangle.transpose() << '\n';
}

void Write(const std::filesystem::path& folder) {
  const s2gs::TriangleMesh mesh = Example();
  for (const char* name : {"mesh.ply", "mesh.obj", "mesh.glb"}) s2gs::WriteMesh(folder / name, mesh);
  std::ofstream text(folder / "mesh.txt");
  text << std::setprecision(9) << mesh.vertices.size() << '\n';
  for (size_t i = 0; i < mesh.vertices.size(); ++i) {
    text << mesh.vertices[i].transpose() << ' ' << mesh.normals[i].transpose() << ' '
         << mesh.colors[i].cast<int>().transpose() << '\n';
  }
  for (const auto& triangle : mesh.triangles) text << triangle.transpose() << '\n';
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) return 2;
  try {
    Write(argv[1]);
    WriteTextured(argv[1]);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
  return 0;
}
