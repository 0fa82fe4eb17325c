#include "mesh/refine/depth_outlines.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <memory>
#include <optional>
#include <vector>

#include "mesh/refine/offset_field.h"
#include "mesh/refine/vertex_visibility.h"
#include "mesh/surface/vertex_normals.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {
namespace {

// Between a ray and the surface at an outline: right angles, but for what a fused mesh's normals are off.
constexpr float kMaxCosine = 0.35F;
// How far from a vertex outlines are looked for along its normal, and in which steps [px].
constexpr float kInwards = 4;
constexpr float kOutwards = 6;
constexpr float kStep = 0.5F;
// The mesh's own outline lies so near to a vertex that is on it [px].
constexpr float kOnOutline = 1.5F;
// Within a pixel of its outline a surface of radius R falls by sqrt(2 R): by as much as this with 290 px.
// What falls by more from one step to the next ends there, or begins [px at the vertex].
constexpr float kJump = 24;
// A vertex on an outline is a pixel before it or behind it, and as much nearer or farther than what ends.
constexpr float kBeside = 2 * kJump;
// Behind an outline so much must be far, too: less is a gap between splats [steps].
constexpr int kStaysFar = 3;
// Beside 1 for an outline, whose place is a whole pixel's: the mean over some edges' length counts.
constexpr double kSmoothness = 30;
// Beside 1 for an outline: what stays.
constexpr float kHeld = 1000;
// Pull to where the mesh is: beside outlines it moves within sqrt(30 / .3) edges, ten. What is farther from
// them lies in hollows, which a wider move closes (tests/bench/notes/refinement.md).
constexpr double kPrior = 0.3;
// Views whose offsets are held at once, before they are added up in one order.
constexpr int kViewsPerTurn = 16;

struct VertexOffset {
  uint32_t vertex = 0;
  float outwards = 0;  // [unit of the poses]
};

// Depths at the values' places in a map: infinite where there is nothing.
struct DepthPicture {
  int width = 0;
  int height = 0;
  std::vector<float> depths;
};

// Whether any of the mask's pixels whose centres are next to a position in the map has the object.
bool IsInMask(const DepthView& view, const Eigen::Vector2d& position) {
  const Image8& mask = view.mask;
  const double x = position.x() * mask.width / view.camera.width - 0.5;
  const double y = position.y() * mask.height / view.camera.height - 0.5;
  for (const double row : {std::floor(y), std::ceil(y)}) {
    for (const double column : {std::floor(x), std::ceil(x)}) {
      if (column < 0 || row < 0 || column >= mask.width || row >= mask.height) continue;
      if (*mask.Pixel(static_cast<int>(column), static_cast<int>(row)) != 0) return true;
    }
  }
  return false;
}

DepthPicture MapOf(const DepthView& view) {
  DepthPicture map = {view.camera.width, view.camera.height, view.depths};
  for (int row = 0; row < map.height; ++row) {
    for (int column = 0; column < map.width; ++column) {
      float& depth = map.depths[static_cast<size_t>(row) * map.width + column];
      const bool is_there =
          std::isfinite(depth) && depth > 0 &&
          (view.mask.pixels.empty() || IsInMask(view, view.first_position + Eigen::Vector2d(column, row)));
      if (!is_there) depth = std::numeric_limits<float>::infinity();
    }
  }
  return map;
}

// The camera that has the values' places of a map at its pixels' centres.
ObjectView CameraAtValues(const DepthView& view) {
  ObjectView camera = view.camera;
  camera.cx += 0.5 - view.first_position.x();
  camera.cy += 0.5 - view.first_position.y();
  return camera;
}

// How far from `start` a surface that has depth `depth` there ends along `direction`, before something far
// behind it [px]; nothing where it does not, or where what ends is something else.
std::optional<float> EndOfSurface(const DepthPicture& map, const Eigen::Vector2f& start,
                                  const Eigen::Vector2f& direction, float depth, float pixel) {
  const auto depth_at = [&](float along) {
    const Eigen::Vector2f p = start + along * direction;
    return map.depths[static_cast<size_t>(p.y()) * map.width + static_cast<size_t>(p.x())];
  };
  float last = depth_at(-kInwards);
  if (!std::isfinite(last)) return std::nullopt;
  for (float along = kStep - kInwards; along <= kOutwards; along += kStep) {
    const float there = depth_at(along);
    if (there < last - kJump * pixel) return std::nullopt;  // something begins before it
    if (there <= last + kJump * pixel) {
      last = there;
      continue;
    }
    if (!(std::abs(last - depth) < kBeside * pixel)) return std::nullopt;
    for (int i = 1; i < kStaysFar; ++i) {
      if (!(depth_at(along + static_cast<float>(i) * kStep) > last + kJump * pixel)) return std::nullopt;
    }
    return along;
  }
  return std::nullopt;
}

std::vector<VertexOffset> OffsetsIn(const DepthView& view, const TriangleMesh& mesh,
                                    const std::vector<uint8_t>& is_held) {
  const ObjectView camera = CameraAtValues(view);
  const DepthPicture seen = MapOf(view);
  const DepthPicture own = {seen.width, seen.height, RenderMeshDepth(mesh, camera)};
  const Eigen::Matrix3f rotation = camera.cam_from_object.rotation.toRotationMatrix().cast<float>();
  const Eigen::Vector3f translation = camera.cam_from_object.translation.cast<float>();
  const Eigen::Array2f focal(static_cast<float>(camera.fx), static_cast<float>(camera.fy));
  const Eigen::Vector2f principal(static_cast<float>(camera.cx), static_cast<float>(camera.cy));
  const float border = kOutwards + kStaysFar * kStep;
  std::vector<VertexOffset> offsets;
  for (size_t i = 0; i < mesh.vertices.size(); ++i) {
    if (is_held[i] != 0) continue;
    const Eigen::Vector3f x = rotation * mesh.vertices[i] + translation;
    const Eigen::Vector3f normal = rotation * mesh.normals[i];
    if (!(x.z() > 0) || !(std::abs(normal.dot(x)) < kMaxCosine * x.norm())) continue;
    const Eigen::Vector2f p = (focal * x.head<2>().array() / x.z()).matrix() + principal;
    if (!(p.x() >= border && p.y() >= border && p.x() < static_cast<float>(camera.width) - border &&
          p.y() < static_cast<float>(camera.height) - border)) {
      continue;
    }
    // Of the position by a step along the normal [px per unit].
    const Eigen::Vector2f shift =
        (focal * (normal.head<2>() - normal.z() / x.z() * x.head<2>()).array() / x.z()).matrix();
    const float length = shift.norm();
    if (!(length > 0)) continue;
    const float pixel = x.z() / focal.maxCoeff();
    const std::optional<float> mesh_end = EndOfSurface(own, p, shift / length, x.z(), pixel);
    if (!mesh_end || std::abs(*mesh_end) > kOnOutline) continue;
    const std::optional<float> end = EndOfSurface(seen, p, shift / length, x.z(), pixel);
    if (end) offsets.push_back({static_cast<uint32_t>(i), (*end - *mesh_end) / length});
  }
  return offsets;
}

struct Observed {
  std::vector<OffsetObservation> offsets;  // by vertex: the mean, and of how many views
  double pixel = 0;                        // of the depth maps at a vertex in the middle of the mesh's
};

Observed Observe(const DepthViewSource& views, const TriangleMesh& mesh, const std::vector<uint8_t>& is_held,
                 int num_threads, Reporter& reporter) {
  Observed observed;
  observed.offsets.resize(mesh.vertices.size());
  const Eigen::Vector3d middle = mesh.vertices[mesh.vertices.size() / 2].cast<double>();
  for (int begin = 0; begin < views.size(); begin += kViewsPerTurn) {
    if (reporter.StopRequested()) throw Interrupted();
    reporter.Progress("outlines", begin, views.size());
    const int count = std::min(kViewsPerTurn, views.size() - begin);
    std::vector<std::vector<VertexOffset>> offsets(count);
    std::vector<double> pixels(count);
    ParallelFor(count, num_threads, [&](int64_t k) {
      const std::shared_ptr<const DepthView> view = views.Load(begin + static_cast<int>(k));
      offsets[k] = OffsetsIn(*view, mesh, is_held);
      pixels[k] = (view->camera.cam_from_object * middle).z() / view->camera.fx;
    });
    for (int k = 0; k < count; ++k) {
      observed.pixel += pixels[k] / views.size();
      for (const VertexOffset& offset : offsets[k]) {
        observed.offsets[offset.vertex].offset += offset.outwards;
        observed.offsets[offset.vertex].weight += 1;
      }
    }
  }
  reporter.Progress("outlines", views.size(), views.size());
  for (OffsetObservation& offset : observed.offsets) {
    if (offset.weight > 0) offset.offset /= offset.weight;
  }
  return observed;
}

}  // namespace

DepthOutlineSummary MoveToDepthOutlines(const DepthViewSource& views, std::optional<double> table_height,
                                        int num_threads, Reporter& reporter, TriangleMesh* mesh) {
  DepthOutlineSummary summary;
  if (mesh->triangles.empty()) return summary;
  num_threads = NumThreadsOf(num_threads);
  ComputeNormals(mesh);
  std::vector<uint8_t> is_held;
  is_held.reserve(mesh->vertices.size());
  for (const Eigen::Vector3f& vertex : mesh->vertices)
    is_held.push_back(table_height && !(vertex.z() > *table_height) ? 1 : 0);
  Observed observed = Observe(views, *mesh, is_held, num_threads, reporter);
  for (const OffsetObservation& offset : observed.offsets) {
    summary.num_vertices += offset.weight > 0 ? 1 : 0;
    summary.num_outlines += static_cast<int64_t>(offset.weight);
  }
  if (summary.num_vertices == 0) return summary;
  for (size_t i = 0; i < is_held.size(); ++i) {
    if (is_held[i] != 0) observed.offsets[i] = {0, kHeld};
  }
  const std::vector<float> offsets =
      SmoothOffsets(VertexGraph(*mesh), observed.offsets, kSmoothness, kPrior, num_threads);
  double sum = 0;
  double squares = 0;
  for (size_t i = 0; i < offsets.size(); ++i) {
    if (is_held[i] != 0) continue;
    mesh->vertices[i] += offsets[i] * mesh->normals[i];
    const double pixels = offsets[i] / observed.pixel;
    sum += pixels;
    squares += pixels * pixels;
  }
  const auto count = static_cast<double>(offsets.size());
  summary.mean_offset_px = sum / count;
  summary.rms_offset_px = std::sqrt(squares / count);
  ComputeNormals(mesh);
  return summary;
}

}  // namespace s2gs
