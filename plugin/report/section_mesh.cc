#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <system_error>

#include "mesh/surface/decimate.h"
#include "mesh/surface/vertex_normals.h"
#include "plugin/report/data_uri.h"
#include "plugin/report/mesh_figures.h"
#include "plugin/report/plot.h"
#include "plugin/report/sections.h"
#include "s2gs/image/photos.h"
#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

// About 0.55 MB in the page.
constexpr int64_t kViewerTriangles = 30000;
// Two rays make a depth, the third can contradict it.
constexpr int kFewViews = 3;

std::vector<ObjectView> Views(const ReportInput& input) {
  std::vector<ObjectView> views;
  if (!input.object) return views;
  for (const auto& [id, image] : input.object->images) {
    const Camera pinhole =
        PlanUndistortion(input.object->cameras.at(image.camera_id), input.workspace.ObjectModel()).pinhole;
    const Eigen::Vector2d focal = FocalLengths(pinhole);
    const Eigen::Vector2d principal = PrincipalPoint(pinhole);
    views.push_back({static_cast<int>(pinhole.width), static_cast<int>(pinhole.height), focal.x(), focal.y(),
                     principal.x(), principal.y(), image.cam_from_world});
  }
  return views;
}

// Turns mesh and cameras so that `up` becomes z, as the viewer and the size in the page take it.
void TurnUpright(const Eigen::Vector3d& up, TriangleMesh* mesh, std::vector<ObjectView>* cameras) {
  const Eigen::Quaterniond turn = Eigen::Quaterniond::FromTwoVectors(up, Eigen::Vector3d::UnitZ());
  const Eigen::Matrix3f rotation = turn.toRotationMatrix().cast<float>();
  for (Eigen::Vector3f& vertex : mesh->vertices) vertex = rotation * vertex;
  for (Eigen::Vector3f& normal : mesh->normals) normal = rotation * normal;
  for (ObjectView& camera : *cameras) {
    camera.cam_from_object.rotation = camera.cam_from_object.rotation * turn.conjugate();
  }
}

std::string Length(double length, const ReportInput& input) {
  if (input.turntable && input.turntable->units == LengthUnit::kMetre) {
    return Significant(1000 * length, 4) + " mm";
  }
  return Significant(length, 4);
}

void WriteViewer(const TriangleMesh& mesh, const std::vector<int>& views, HtmlWriter* out) {
  const PackedMesh packed = PackMesh(mesh, views, FindHoles(mesh));
  out->Open("div", {{"class", "viewer"}, {"id", "viewer"}});
  out->Open("p", {{"class", "controls"}});
  for (const auto& [mode, label] :
       {std::pair("color", "colour"), std::pair("shape", "shape"), std::pair("views", "views per vertex")}) {
    out->Element("button", label, {{"type", "button"}, {"data-mode", mode}});
  }
  out->Open("label").Void("input", {{"type", "checkbox"}, {"checked", ""}, {"id", "viewer-holes"}});
  out->Text(" holes").Close().Close();
  out->Element("canvas", "",
               {{"width", "960"},
                {"height", "720"},
                {"tabindex", "0"},
                {"aria-label", "the mesh, to be turned by the mouse, one finger or the arrow keys"}});
  out->Element("p", "", {{"class", "legend"}, {"id", "viewer-legend"}});
  const auto vector = [](const Eigen::Vector3f& v) { return fmt::format("{} {} {}", v.x(), v.y(), v.z()); };
  out->Element("script", "",
               {{"type", "application/octet-stream"},
                {"id", "viewer-mesh"},
                {"data-low", vector(packed.low)},
                {"data-size", fmt::format("{}", packed.size)},
                {"data-index-bytes", std::to_string(packed.index_bytes)},
                {"data-positions", Base64(packed.positions)},
                {"data-colors", Base64(packed.colors)},
                {"data-views", Base64(packed.views)},
                {"data-triangles", Base64(packed.triangles)},
                {"data-holes", Base64(packed.holes)},
                {"data-few-views", std::to_string(kFewViews)}});
  out->Close();
}

void WriteCoverage(const std::vector<int>& views, size_t num_photos, ReportSection* section,
                   std::vector<Tile>* tiles) {
  std::vector<int> sorted = views;
  std::sort(sorted.begin(), sorted.end());
  const auto few = std::lower_bound(sorted.begin(), sorted.end(), kFewViews) - sorted.begin();
  const double few_pct = 100.0 * static_cast<double>(few) / static_cast<double>(sorted.size());
  const int median = sorted[sorted.size() / 2];
  tiles->push_back({"Views of a vertex", std::to_string(median),
                    fmt::format("median, of {}", Count(num_photos, "photo"))});
  tiles->push_back({"Hardly seen", Significant(few_pct, 2) + " %",
                    fmt::format("of the vertices are seen by fewer than {} photos", kFewViews)});
  section->numbers["views_per_vertex"] = {
      {"median", median}, {"fewer_than_3_pct", few_pct}, {"photos", num_photos}};
}

// Sizes, counts and holes as numbers; returns them for people. \param num_shown  triangles in the viewer.
std::vector<Tile> WriteFigures(const ReportInput& input, const MeshFigures& figures, size_t num_shown,
                               ReportSection* section) {
  const Eigen::Vector3d size = figures.high - figures.low;
  double rim = 0;
  for (const MeshFigures::Hole& hole : figures.holes) rim += hole.length;
  std::vector<Tile> tiles = {
      {"Size",
       fmt::format("{} × {} × {}", Length(size.x(), input), Length(size.y(), input), Length(size.z(), input)),
       input.turntable && input.turntable->units == LengthUnit::kMetre
           ? "width, depth, height"
           : "width, depth, height in the scene's own unit: no length is known"},
      {"Triangles", std::to_string(figures.num_triangles),
       fmt::format("{} vertices, {}; {} in the viewer", figures.num_vertices,
                   Count(figures.num_clusters, "part"), num_shown)},
      {"Holes", std::to_string(figures.holes.size()),
       figures.holes.empty()
           ? "the mesh is closed"
           : fmt::format("the longest rim is {} (of what stood on the table, its underside), all together {}",
                         Length(figures.holes.front().length, input), Length(rim, input))}};
  section->numbers["vertices"] = figures.num_vertices;
  section->numbers["triangles"] = figures.num_triangles;
  section->numbers["parts"] = figures.num_clusters;
  section->numbers["size"] = {size.x(), size.y(), size.z()};
  section->numbers["unit"] = input.turntable && input.turntable->units == LengthUnit::kMetre ? "m" : "sfm";
  section->numbers["area"] = figures.area;
  section->numbers["holes"] = {{"count", figures.holes.size()},
                               {"rim_length", rim},
                               {"longest_rim", figures.holes.empty() ? 0 : figures.holes.front().length}};
  if (figures.holes.empty()) {
    section->numbers["volume"] = figures.volume;
  }
  return tiles;
}

}  // namespace

ReportSection MeshSection(const ReportInput& input, Reporter& reporter) {
  ReportSection section{"mesh", "Mesh", {}, {}};
  section.numbers = nlohmann::ordered_json::object();
  HtmlWriter& out = section.html;
  std::error_code ec;
  if (!std::filesystem::exists(input.workspace.TsdfMesh(), ec)) {
    WriteMissing("There is no mesh yet: tsdf_mesher makes it from the depth maps.", &out);
    return section;
  }
  TriangleMesh mesh;
  try {
    mesh = ReadPlyMesh(input.workspace.TsdfMesh());
  } catch (const UserError& error) {
    reporter.Warn(std::string("no mesh: ") + error.what());
  }
  if (mesh.triangles.empty()) {
    WriteMissing("The mesh cannot be read, or has no triangles.", &out);
    return section;
  }
  std::vector<ObjectView> cameras;
  try {
    cameras = Views(input);
  } catch (const UserError& error) {
    reporter.Warn(std::string("no views per vertex: ") + error.what());
  }
  if (input.IsOneBody()) TurnUpright(input.Up(), &mesh, &cameras);
  const MeshFigures figures = MeasureMesh(mesh);
  reporter.Info(fmt::format("simplifies {} triangles for the report's viewer", figures.num_triangles));
  DecimateMesh(kViewerTriangles, &mesh);
  ComputeNormals(&mesh);
  const std::vector<int> views = CountViewsOfVertices(mesh, cameras);

  std::vector<Tile> tiles = WriteFigures(input, figures, mesh.triangles.size(), &section);
  if (!cameras.empty() && !views.empty()) WriteCoverage(views, cameras.size(), &section, &tiles);
  WriteTiles(tiles, &out);
  WriteViewer(mesh, cameras.empty() ? std::vector<int>() : views, &out);
  out.Element("p",
              "Drag to turn, wheel or two fingers to zoom. A vertex counts as seen where the mesh itself "
              "does not hide "
              "it and it is looked at less steeply than 80°. Rims of holes are red.",
              {{"class", "note"}});
  return section;
}

}  // namespace s2gs
