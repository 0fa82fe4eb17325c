#include "mesh/refine/surface_relief.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

namespace s2gs {
namespace {

constexpr int kHalf = kPatchSide / 2;
// Patches with more vertices stay flat: they lie a tenth of a pixel apart.
constexpr size_t kMaxVertices = 2048;
constexpr size_t kNumSlots = 4 * kMaxVertices;  // a power of 2
// Of a triangle's normal, to the patch's and to the rays: below, its picture is squeezed to a tenth.
constexpr float kLeastCosine = 0.1F;
// A point this far outside of a triangle, in barycentric coordinates, is on its edge.
constexpr float kEdgeTolerance = 1e-4F;

// Twice the signed area of a, b and the point (x, y), seen along the patch's normal.
float Cross(const Eigen::Vector3f& a, const Eigen::Vector3f& b, float x, float y) {
  return (b.x() - a.x()) * (y - a.y()) - (b.y() - a.y()) * (x - a.x());
}

// The highest surface at each point of the patch, in the patch's own axes and spacings.
struct HeightField {
  HeightField() { heights.fill(-std::numeric_limits<float>::infinity()); }

  // \return  whether the triangle's box reaches into the patch.
  bool Add(const Eigen::Vector3f& a, const Eigen::Vector3f& b, const Eigen::Vector3f& c) {
    const Eigen::Vector3f low = a.cwiseMin(b).cwiseMin(c);
    const Eigen::Vector3f high = a.cwiseMax(b).cwiseMax(c);
    // Surfaces that stand further off than the patch is wide are others. Not numbers are outside, too.
    if (!(low.head<2>().maxCoeff() <= kHalf && high.head<2>().minCoeff() >= -kHalf)) return false;
    if (!(low.z() <= kPatchSide && high.z() >= -kPatchSide)) return false;
    const float area = Cross(a, b, c.x(), c.y());
    if (!(area > std::numeric_limits<float>::min())) return true;
    const Eigen::Vector3f normal = (b - a).cross(c - a).normalized();
    if (!(normal.z() > kLeastCosine)) return true;
    const auto first = [](float value) {
      return static_cast<int>(std::ceil(std::max<float>(value - kEdgeTolerance, -kHalf)));
    };
    const auto last = [](float value) {
      return static_cast<int>(std::floor(std::min<float>(value + kEdgeTolerance, kHalf)));
    };
    for (int j = first(low.y()); j <= last(high.y()); ++j) {
      for (int i = first(low.x()); i <= last(high.x()); ++i) {
        const auto x = static_cast<float>(i);
        const auto y = static_cast<float>(j);
        const float u = Cross(b, c, x, y) / area;
        const float v = Cross(c, a, x, y) / area;
        const float w = 1 - u - v;
        if (!(u >= -kEdgeTolerance && v >= -kEdgeTolerance && w >= -kEdgeTolerance)) continue;
        const int k = (j + kHalf) * kPatchSide + i + kHalf;
        const float height = u * a.z() + v * b.z() + w * c.z();
        if (!(height > heights[k])) continue;
        heights[k] = height;
        normals[k] = normal;
      }
    }
    return true;
  }

  std::array<float, kPatchSize> heights;
  std::array<Eigen::Vector3f, kPatchSize> normals;
};

}  // namespace

SurfaceRelief::Scratch::Scratch() : slots_(kNumSlots) { places_.reserve(kMaxVertices); }

void SurfaceRelief::Scratch::Clear() {
  places_.clear();
  opened_.clear();
  if (++turn_ != 0) return;
  std::fill(slots_.begin(), slots_.end(), Slot());
  turn_ = 1;
}

SurfaceRelief::SurfaceRelief(const TriangleMesh& mesh) : mesh_(mesh), starts_(mesh.vertices.size() + 1) {
  for (const auto& triangle : mesh.triangles) {
    for (const uint32_t vertex : triangle) ++starts_[vertex + 1];
  }
  for (size_t i = 0; i + 1 < starts_.size(); ++i) starts_[i + 1] += starts_[i];
  triangles_.resize(starts_.back());
  std::vector<size_t> next(starts_.begin(), starts_.end() - 1);
  for (size_t i = 0; i < mesh.triangles.size(); ++i) {
    for (const uint32_t vertex : mesh.triangles[i]) triangles_[next[vertex]++] = static_cast<uint32_t>(i);
  }
}

void SurfaceRelief::Lay(uint32_t vertex, Scratch* scratch, SurfacePatch* patch) const {
  scratch->Clear();
  std::vector<Scratch::Place>& places = scratch->places_;
  Eigen::Matrix3f axes;  // of the patch, as rows
  axes << patch->u.transpose(), patch->v.transpose(), patch->normal.transpose();
  // The vertex's number among those met so far; nothing when there is no room for it.
  const auto place_of = [&](uint32_t i) -> std::optional<uint32_t> {
    for (size_t at = i % kNumSlots;; at = (at + 1) % kNumSlots) {
      Scratch::Slot& slot = scratch->slots_[at];
      if (slot.turn == scratch->turn_) {
        if (slot.vertex == i) return slot.place;
        continue;
      }
      if (places.size() >= kMaxVertices) return std::nullopt;
      slot = {i, static_cast<uint32_t>(places.size()), scratch->turn_};
      places.push_back({i, false, false, axes * (mesh_.vertices[i] - patch->middle) / patch->spacing});
      return slot.place;
    }
  };
  const auto open = [&](uint32_t place) {
    if (places[place].is_open) return;
    places[place].is_open = true;
    scratch->opened_.push_back(place);
  };
  HeightField field;
  place_of(vertex);
  open(0);
  // From triangle to triangle as far as they reach into the patch.
  for (size_t next = 0; next < scratch->opened_.size(); ++next) {
    const uint32_t at = scratch->opened_[next];
    const uint32_t from = places[at].vertex;
    for (size_t t = starts_[from]; t < starts_[from + 1]; ++t) {
      std::array<uint32_t, 3> corners{};
      bool is_new = true;
      for (int c = 0; c < 3 && is_new; ++c) {
        const std::optional<uint32_t> place = place_of(mesh_.triangles[triangles_[t]][c]);
        if (!place) return;  // too fine for the photos to tell its relief
        is_new = !places[*place].is_done;
        if (is_new) corners[c] = *place;
      }
      if (!is_new) continue;
      if (!field.Add(places[corners[0]].x, places[corners[1]].x, places[corners[2]].x)) continue;
      for (const uint32_t corner : corners) open(corner);
    }
    places[at].is_done = true;
  }
  std::array<Eigen::Vector3f, SurfacePatch::kMaxViews> rays;  // in the patch's axes
  for (int i = 0; i < patch->num_views; ++i) {
    rays[i] = axes * (patch->views[i]->center() - patch->middle).normalized();
  }
  patch->num_points = 0;
  for (int k = 0; k < kPatchSize; ++k) {
    if (!std::isfinite(field.heights[k])) continue;
    const bool faces_all = std::all_of(rays.begin(), rays.begin() + patch->num_views, [&](const auto& ray) {
      return field.normals[k].dot(ray) > kLeastCosine;
    });
    if (!faces_all) continue;
    const int column = k % kPatchSide;
    const int row = k / kPatchSide;
    patch->points[patch->num_points++] = {static_cast<float>(column - kHalf), static_cast<float>(row - kHalf),
                                          field.heights[k]};
  }
}

}  // namespace s2gs
