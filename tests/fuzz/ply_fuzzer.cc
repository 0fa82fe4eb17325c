#include <cstdint>
#include <sstream>

#include "mesh/surface/triangle_mesh.h"
#include "sfm_split/base/error.h"
#include "sfm_split/scene/io/ply_file.h"
#include "tests/fuzz/fuzz_seeds.h"

std::vector<std::string> FuzzSeeds() {
  s2gs::TriangleMesh mesh;
  mesh.vertices = {{0, 0, 0}, {.1F, 0, 0}, {0, 1e-20F, 0}, {0, 0, -3}};
  mesh.normals.assign(4, {0, 0, 1});
  mesh.colors.assign(4, {1, 2, 3});
  mesh.triangles = {{0, 2, 1}, {0, 1, 3}};
  mesh.extra_vertex_properties.push_back({"w", std::vector<double>{1, 2, 3, 4}, {}, {}});
  mesh.extra_vertex_properties.push_back(
      {"n", std::vector<int16_t>{5, 6}, s2gs::PlyType::kInt16, {0, 0, 2, 2, 2}});
  std::vector<std::string> seeds;
  for (const s2gs::PlyFormat format :
       {s2gs::PlyFormat::kAscii, s2gs::PlyFormat::kBinaryLittleEndian, s2gs::PlyFormat::kBinaryBigEndian}) {
    std::ostringstream stream;
    s2gs::WritePlyMesh(stream, mesh, format);
    seeds.push_back(stream.str());
  }
  return seeds;
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  const std::string bytes(reinterpret_cast<const char*>(data), size);
  try {
    std::istringstream stream(bytes);
    const s2gs::PlyFile file = s2gs::ReadPly(stream, "fuzz");
    // What was accepted must be fit to be written.
    std::ostringstream copy;
    s2gs::WritePly(copy, file);
  } catch (const s2gs::UserError&) {
  }
  try {
    std::istringstream stream(bytes);
    const s2gs::TriangleMesh mesh = s2gs::ReadPlyMesh(stream, "fuzz");
    std::ostringstream copy;
    s2gs::WritePlyMesh(copy, mesh);
  } catch (const s2gs::UserError&) {
  }
  return 0;
}
