#include "plugin/outputs/beside_table.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>

#include "mesh/fusion/tsdf.h"
#include "mesh/surface/mesh_cleanup.h"
#include "mesh/surface/table_top.h"
#include "mesh/surface/triangle_tree.h"
#include "s2gs/image/photos.h"
#include "s2gs/kernel/foreground.h"

namespace s2gs {
namespace {

constexpr int kMaxViews = 60;   // evenly from all photos
constexpr int kLongSide = 480;  // [px]: ground beside a table is larger than details of the object.
constexpr float kMinAlpha = 0.5F;
constexpr double kSmallShare = 0.1;  // of the largest part's area, as meshes leave out by default.

// The table's axis becomes z through the origin.
Rigid3 AlignedFromObject(const TurntableAxis& axis) {
  const Eigen::Quaterniond rotation =
      Eigen::Quaterniond::FromTwoVectors(axis.direction, Eigen::Vector3d::UnitZ());
  return {rotation, -(rotation * axis.point)};
}

DepthView RotatingDepth(const PinholeView& photo, const Rigid3& object_from_aligned, Backend* backend) {
  const double scale = std::min(1.0, static_cast<double>(kLongSide) / std::max(photo.width, photo.height));
  RenderRequest request;
  request.view = ResizeView(photo, std::max(1, static_cast<int>(photo.width * scale)),
                            std::max(1, static_cast<int>(photo.height * scale)));
  request.drawn = DrawnBody::kForeground;
  request.geometry = true;
  const RenderedView rendered = backend->Render(request);
  const PinholeView& view = request.view;
  DepthView depth;
  depth.camera = {view.width,
                  view.height,
                  view.fx,
                  view.fy,
                  view.cx,
                  view.cy,
                  view.cam_from_object * object_from_aligned};
  depth.depths.assign(rendered.median_depth.begin(), rendered.median_depth.end());
  for (size_t i = 0; i < depth.depths.size(); ++i) {
    if (rendered.alpha[i] < kMinAlpha) depth.depths[i] = 0;
  }
  return depth;
}

std::vector<TriangleCorners> CornersOf(const TriangleMesh& mesh) {
  std::vector<TriangleCorners> all;
  all.reserve(mesh.triangles.size());
  for (const Triangle& triangle : mesh.triangles) {
    TriangleCorners corners;
    for (int i = 0; i < 3; ++i) corners[i] = mesh.vertices[triangle[i]].cast<double>();
    all.push_back(corners);
  }
  return all;
}

// What stands on a table hangs together with it: a part that touches nothing is none where it is small and
// lies wholly above, or aside of, all that the table carries. Loose ends of the thing itself lie beside it.
void LeaveOutFloating(const TableTop& table, const TriangleMesh& all, std::vector<bool>* is_kept) {
  TriangleMesh mesh = all;
  std::vector<size_t> places;
  for (size_t t = 0; t < is_kept->size(); ++t) {
    if ((*is_kept)[t]) places.push_back(t);
  }
  KeepTriangles(*is_kept, &mesh);
  const std::vector<int> parts = ClusterOfTriangles(mesh);
  if (parts.empty()) return;
  struct Extent {
    double area = 0;
    double low = std::numeric_limits<double>::infinity();
    double high = -low;
    double inner = low;
    double outer = 0;
  };
  std::vector<Extent> extents(*std::max_element(parts.begin(), parts.end()) + 1);
  // Of the table alone it is no measure how far it reaches.
  std::vector<Extent> above(extents.size());
  for (size_t i = 0; i < parts.size(); ++i) {
    const Triangle& triangle = mesh.triangles[i];
    const Eigen::Vector3f a = mesh.vertices[triangle[0]];
    const double area = (mesh.vertices[triangle[1]] - a).cross(mesh.vertices[triangle[2]] - a).norm();
    extents[parts[i]].area += area;
    for (int k = 0; k < 3; ++k) {
      const Eigen::Vector3f x = mesh.vertices[triangle[k]];
      for (Extent* extent : {&extents[parts[i]], &above[parts[i]]}) {
        if (extent == &above[parts[i]] && x.z() <= table.disc.CutHeight()) continue;
        const double radius = x.head<2>().norm();
        extent->low = std::min<double>(extent->low, x.z());
        extent->high = std::max<double>(extent->high, x.z());
        extent->inner = std::min(extent->inner, radius);
        extent->outer = std::max(extent->outer, radius);
      }
    }
  }
  const double largest =
      std::max_element(extents.begin(), extents.end(), [](const Extent& a, const Extent& b) {
        return a.area < b.area;
      })->area;
  Extent carried;
  for (size_t part = 0; part < extents.size(); ++part) {
    if (extents[part].low > table.disc.CutHeight()) continue;
    carried.high = std::max(carried.high, above[part].high);
    carried.outer = std::max(carried.outer, above[part].outer);
  }
  for (size_t i = 0; i < parts.size(); ++i) {
    const Extent& part = extents[parts[i]];
    const bool is_aside = part.low > carried.high || part.inner > carried.outer;
    const bool is_small = part.area < kSmallShare * largest;
    if (part.low > table.disc.CutHeight() && is_aside && is_small) (*is_kept)[places[i]] = false;
  }
}

}  // namespace

std::vector<uint32_t> FindRotatingBesideTable(const TrainingScene& scene, Backend* backend,
                                              Reporter& reporter) {
  if (!scene.axis || scene.mode != TrainMode::kS2gs || scene.photos.empty()) return {};
  if (!IsOneStation(scene)) return {};
  const Rigid3 aligned_from_object = AlignedFromObject(*scene.axis);
  const Rigid3 object_from_aligned = aligned_from_object.Inverse();
  std::vector<DepthView> depths;
  const size_t count = std::min<size_t>(kMaxViews, scene.photos.size());
  for (size_t i = 0; i < count; ++i) {
    if (reporter.StopRequested()) throw Interrupted();
    const PinholeView& view = scene.photos[i * scene.photos.size() / count].view;
    depths.push_back(RotatingDepth(view, object_from_aligned, backend));
  }
  const bool is_empty = std::all_of(depths.begin(), depths.end(), [](const DepthView& view) {
    return std::none_of(view.depths.begin(), view.depths.end(), [](float depth) { return depth > 0; });
  });
  if (is_empty) return {};
  TsdfOptions options;
  options.backend = TsdfBackend::kCpu;
  Reporter silent;
  TriangleMesh all = MeshFromDepthMaps(DepthViewList(std::move(depths)), options, silent);
  const std::optional<TableTop> table = FindTableTop(all);
  if (!table) return {};
  std::vector<bool> is_kept = StandsOnTable(*table, all);
  LeaveOutFloating(*table, all, &is_kept);
  TriangleMesh kept = all;
  KeepTriangles(is_kept, &kept);
  std::vector<bool> is_beside = is_kept;
  is_beside.flip();
  KeepTriangles(is_beside, &all);
  if (kept.triangles.empty() || all.triangles.empty()) return {};
  const Gaussians gaussians = backend->GetGaussians();
  std::vector<uint32_t> rotating;
  std::vector<Eigen::Vector3d> places;
  for (size_t i = 0; i < gaussians.size(); ++i) {
    if (!IsForeground(gaussians.foreground_logit[i])) continue;
    const float* x = gaussians.centre.data() + 3 * i;
    const Eigen::Vector3d place = aligned_from_object * Eigen::Vector3d(x[0], x[1], x[2]);
    if (!place.allFinite()) continue;
    rotating.push_back(static_cast<uint32_t>(i));
    places.push_back(place);
  }
  const std::vector<double> to_kept = DistancesToTriangles(places, CornersOf(kept));
  const std::vector<double> to_beside = DistancesToTriangles(places, CornersOf(all));
  std::vector<uint32_t> beside;
  for (size_t i = 0; i < rotating.size(); ++i) {
    if (to_beside[i] < to_kept[i]) beside.push_back(rotating[i]);
  }
  return beside;
}

}  // namespace s2gs
