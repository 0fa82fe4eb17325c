#include "plugin/outputs/known_top.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdint>
#include <limits>
#include <nlohmann/json.hpp>
#include <vector>

#include "mesh/refine/table_texture.h"
#include "mesh/surface/vertex_normals.h"
#include "sfm_split/base/file_io.h"

namespace s2gs {
namespace {

constexpr uint64_t kMaxMaskLogBytes = uint64_t{1} << 20;
// The table's axis as meshes have it, z: the cosine between both, and the distance in radii of the table.
constexpr double kAlongZ = 0.9999;
constexpr double kOffZ = 0.01;
// Plain tables with shadows on them have .10 to .23, speckled ones .99.
constexpr double kMaxTextured = 0.5;

void Flatten(const TablePlane& plane, const std::vector<uint32_t>& top, TriangleMesh* mesh) {
  MoveToHeight(plane.height, top, mesh);
  MoveToHeight(plane.height, StepsOnPlane(plane, top, *mesh), mesh);
}

}  // namespace

std::optional<KnownTop> ReadTop(const Workspace& workspace, const TurntableAxis& axis,
                                const RefinementPhotoSource& photos) {
  if (!Exists(workspace.MaskLog())) return std::nullopt;
  const nlohmann::json line =
      nlohmann::json::parse(ReadWholeFile(workspace.MaskLog(), kMaxMaskLogBytes), nullptr, false);
  const auto is_number = [&](const char* name) { return line.contains(name) && line[name].is_number(); };
  if (!line.is_object() || !is_number("top") || !is_number("top_radius")) return std::nullopt;
  TablePlane plane = {line["top"], line["top_radius"], std::numeric_limits<double>::infinity()};
  for (int i = 0; i < photos.size(); ++i)
    plane.seen_from = std::min(plane.seen_from, photos.Camera(i).cam_from_object.Inverse().translation.z());
  const bool is_z = axis.direction.z() > kAlongZ && axis.point.head<2>().norm() < kOffZ * plane.radius;
  if (!is_z) return std::nullopt;
  const auto is_true = [&](const char* name) { return line.contains(name) && line[name] == true; };
  return KnownTop{plane, is_true("top_seen"), is_true("top_is_plane")};
}

void FlattenTop(const TablePlane& plane, TriangleMesh* mesh) {
  Flatten(plane, LevelFromRim(plane, *mesh), mesh);
}

bool FlattenTable(const KnownTop& known, const RefinementPhotoSource& photos,
                  const MeshRefinementOptions& options, Reporter& reporter, TriangleMesh* mesh) {
  if (mesh->triangles.empty()) return false;
  const std::vector<uint32_t> top = LevelFromRim(known.plane, *mesh);
  if (top.empty()) return false;
  ComputeNormals(mesh);
  const std::optional<double> textured = TexturedShare(photos, top, options, *mesh, reporter);
  if (!textured) return false;
  const bool is_plane = known.is_plane || *textured < kMaxTextured;
  if (is_plane) Flatten(known.plane, top, mesh);
  reporter.Info(fmt::format("{:.0f} % of the table's top have texture{}: its {} vertices {}", 100 * *textured,
                            known.is_plane ? ", which shows that it is a plane" : "", top.size(),
                            is_plane ? "are moved to its plane" : "stay where photos see them"));
  return is_plane;
}

}  // namespace s2gs
