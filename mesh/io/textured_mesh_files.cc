#include "mesh/io/textured_mesh_files.h"

#include <fmt/format.h>

#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <ostream>
#include <string>
#include <system_error>
#include <utility>

#include "mesh/io/glb_builder.h"
#include "mesh/io/glb_geometry.h"
#include "mesh/io/obj_text.h"
#include "s2gs/image/image_codec.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/scene/io/ply_file.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

// Where in its page each vertex lies, from 0 to 1 to the right and downwards from the top left corner.
std::vector<Eigen::Vector2f> RelativeTexels(const TexturedMesh& mesh) {
  std::vector<Eigen::Vector2f> relative(mesh.texels.size(), Eigen::Vector2f::Zero());
  for (const TexturePage& page : mesh.pages) {
    for (uint64_t t = page.first_triangle; t < page.first_triangle + page.num_triangles; ++t) {
      for (int i = 0; i < 3; ++i) {
        const uint32_t v = mesh.triangles[t][i];
        relative[v] = {mesh.texels[v].x() / static_cast<float>(page.image.width),
                       mesh.texels[v].y() / static_cast<float>(page.image.height)};
      }
    }
  }
  return relative;
}

void WriteMtl(std::ostream& stream, const fs::path& base, size_t num_pages) {
  for (size_t page = 0; page < num_pages; ++page) {
    stream << "newmtl page" << page << "\nKa 1 1 1\nKd 1 1 1\nKs 0 0 0\nillum 1\nmap_Kd "
           << TexturePagePath(base, page).filename().string() << "\n";
  }
}

void WriteObj(std::ostream& stream, const TexturedMesh& mesh, const std::vector<Eigen::Vector2f>& relative,
              const std::string& mtl_name) {
  ObjText obj(stream);
  obj.text() += "mtllib " + mtl_name;
  obj.EndLine();
  for (const Eigen::Vector3f& vertex : mesh.vertices) {
    AppendObjVector("v", vertex, &obj.text());
    obj.EndLine();
  }
  for (const Eigen::Vector2f& uv : relative) {
    obj.text() += "vt ";
    AppendNumber(uv.x(), &obj.text());
    obj.text() += ' ';
    // From the bottom up.
    AppendNumber(1 - uv.y(), &obj.text());
    obj.EndLine();
  }
  for (const Eigen::Vector3f& normal : mesh.normals) {
    AppendObjVector("vn", normal, &obj.text());
    obj.EndLine();
  }
  for (size_t page = 0; page < mesh.pages.size(); ++page) {
    obj.text() += "usemtl page" + std::to_string(page);
    obj.EndLine();
    const uint64_t first = mesh.pages[page].first_triangle;
    for (uint64_t t = first; t < first + mesh.pages[page].num_triangles; ++t) {
      obj.text() += 'f';
      for (int i = 0; i < 3; ++i) {
        for (const char before : {' ', '/', '/'}) {
          obj.text() += before;
          AppendNumber(uint64_t{mesh.triangles[t][i]} + 1, &obj.text());
        }
      }
      obj.EndLine();
    }
  }
  obj.Flush();
}

void WriteGlb(std::ostream& stream, const TexturedMesh& mesh, const std::vector<Eigen::Vector2f>& relative,
              const std::vector<std::string>& pngs, const fs::path& path) {
  GlbBuilder glb;
  nlohmann::json shared = {{"mode", 4}};
  AddGlbPositions(mesh.vertices, &glb, &shared);
  AddGlbNormals(mesh.normals, &glb, &shared);
  shared["attributes"]["TEXCOORD_0"] =
      glb.AddAccessor(relative.size(), 8 * relative.size(), kGlbArrayBuffer,
                      {{"componentType", kGlbFloat}, {"type", "VEC2"}}, [&](std::ostream& out) {
                        out.write(reinterpret_cast<const char*>(relative.data()),
                                  static_cast<std::streamsize>(8 * relative.size()));
                      });
  nlohmann::json& json = glb.json();
  // Linear filters, and no repeating beyond the page.
  json["samplers"][0] = {{"magFilter", 9729}, {"minFilter", 9987}, {"wrapS", 33071}, {"wrapT", 33071}};
  for (size_t page = 0; page < mesh.pages.size(); ++page) {
    nlohmann::json primitive = shared;
    AddGlbTriangles(&mesh.triangles[mesh.pages[page].first_triangle], mesh.pages[page].num_triangles, &glb,
                    &primitive);
    primitive["material"] = page;
    json["meshes"][0]["primitives"].push_back(std::move(primitive));
    json["materials"].push_back(
        {{"name", "page" + std::to_string(page)},
         {"doubleSided", true},
         {"pbrMetallicRoughness",
          {{"baseColorTexture", {{"index", page}}}, {"metallicFactor", 0}, {"roughnessFactor", 1}}}});
    json["textures"].push_back({{"source", page}, {"sampler", 0}});
    const std::string& png = pngs[page];
    const size_t view = glb.AddView(png.size(), kGlbNoTarget, [&png](std::ostream& out) {
      out.write(png.data(), static_cast<std::streamsize>(png.size()));
    });
    json["images"].push_back({{"bufferView", view}, {"mimeType", "image/png"}});
  }
  glb.Write(stream, path);
}

PlyFile MakePly(const fs::path& base, const TexturedMesh& mesh,
                const std::vector<Eigen::Vector2f>& relative) {
  PlyFile file;
  for (size_t page = 0; page < mesh.pages.size(); ++page) {
    file.comments.push_back("TextureFile " + TexturePagePath(base, page).filename().string());
  }
  PlyElement vertices;
  vertices.name = "vertex";
  vertices.num_rows = mesh.vertices.size();
  const auto add = [&](const char* name, const auto& value_of) {
    std::vector<float> column(mesh.vertices.size());
    for (size_t i = 0; i < column.size(); ++i) column[i] = value_of(i);
    vertices.AddColumn(name, std::move(column));
  };
  add("x", [&](size_t i) { return mesh.vertices[i].x(); });
  add("y", [&](size_t i) { return mesh.vertices[i].y(); });
  add("z", [&](size_t i) { return mesh.vertices[i].z(); });
  add("nx", [&](size_t i) { return mesh.normals[i].x(); });
  add("ny", [&](size_t i) { return mesh.normals[i].y(); });
  add("nz", [&](size_t i) { return mesh.normals[i].z(); });
  add("s", [&](size_t i) { return relative[i].x(); });
  add("t", [&](size_t i) { return 1 - relative[i].y(); });
  file.elements.push_back(std::move(vertices));

  PlyElement faces;
  faces.name = "face";
  faces.num_rows = mesh.triangles.size();
  std::vector<int32_t> indices;
  std::vector<float> texcoords;
  std::vector<int32_t> texnumbers;
  std::vector<uint64_t> index_begins = {0};
  std::vector<uint64_t> texcoord_begins = {0};
  for (size_t page = 0; page < mesh.pages.size(); ++page) {
    const uint64_t first = mesh.pages[page].first_triangle;
    for (uint64_t t = first; t < first + mesh.pages[page].num_triangles; ++t) {
      for (int i = 0; i < 3; ++i) {
        const uint32_t v = mesh.triangles[t][i];
        indices.push_back(static_cast<int32_t>(v));
        texcoords.push_back(relative[v].x());
        texcoords.push_back(1 - relative[v].y());
      }
      index_begins.push_back(indices.size());
      texcoord_begins.push_back(texcoords.size());
      texnumbers.push_back(static_cast<int32_t>(page));
    }
  }
  faces.properties.push_back(
      {"vertex_indices", std::move(indices), PlyType::kUint8, std::move(index_begins)});
  faces.properties.push_back({"texcoord", std::move(texcoords), PlyType::kUint8, std::move(texcoord_begins)});
  faces.AddColumn("texnumber", std::move(texnumbers));
  file.elements.push_back(std::move(faces));
  return file;
}

fs::path WithExtension(const fs::path& base, const char* extension) { return base.string() + extension; }

}  // namespace

fs::path TexturePagePath(const fs::path& base, size_t page) {
  return base.string() + "_" + std::to_string(page) + ".png";
}

std::vector<fs::path> WriteTexturedMesh(const fs::path& base, const TexturedMesh& mesh) {
  if (mesh.triangles.empty()) throw UserError(base, "an empty mesh cannot have a texture", "");
  if (mesh.vertices.size() > static_cast<size_t>(std::numeric_limits<int32_t>::max())) {
    throw UserError(base, "has more than 2^31 vertices", "Set a lower Cleanup.max_triangles in tsdf_mesher");
  }
  S2GS_INVARIANT(mesh.normals.size() == mesh.vertices.size() && mesh.texels.size() == mesh.vertices.size());
  const std::vector<Eigen::Vector2f> relative = RelativeTexels(mesh);
  std::vector<std::string> pngs;
  std::vector<FileToWrite> files;
  pngs.reserve(mesh.pages.size());
  for (size_t page = 0; page < mesh.pages.size(); ++page) {
    const fs::path path = TexturePagePath(base, page);
    pngs.push_back(EncodePng(mesh.pages[page].image, path));
    files.push_back({path, [&pngs, page](std::ostream& out) { out << pngs[page]; }});
  }
  const fs::path mtl = WithExtension(base, ".mtl");
  const fs::path glb = WithExtension(base, ".glb");
  files.push_back({mtl, [&](std::ostream& out) { WriteMtl(out, base, mesh.pages.size()); }});
  files.push_back({WithExtension(base, ".obj"),
                   [&](std::ostream& out) { WriteObj(out, mesh, relative, mtl.filename().string()); }});
  files.push_back({WithExtension(base, ".ply"),
                   [&](std::ostream& out) { WritePly(out, MakePly(base, mesh, relative)); }});
  files.push_back({glb, [&](std::ostream& out) { WriteGlb(out, mesh, relative, pngs, glb); }});
  // Pages of a larger texture that stood here before.
  std::vector<fs::path> obsolete;
  std::error_code ec;
  for (size_t page = mesh.pages.size(); fs::exists(TexturePagePath(base, page), ec); ++page) {
    obsolete.push_back(TexturePagePath(base, page));
  }
  WriteFilesTogether(files, obsolete);
  std::vector<fs::path> paths;
  paths.reserve(files.size());
  for (const FileToWrite& file : files) paths.push_back(file.path);
  return paths;
}

}  // namespace s2gs
