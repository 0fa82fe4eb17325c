#include "mesh/surface/table_top.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "mesh/surface/mesh_cleanup.h"

namespace s2gs {
namespace {

constexpr int kBinsPerSide = 1000;
constexpr double kMinCosine = 0.95;
// What looks down by more than walls lean is an underside.
constexpr double kUndersideCosine = -0.5;
constexpr double kMinAreaShare = 0.02;
constexpr double kNearlyAsLarge = 0.3;

// A triangle.
struct Patch {
  Eigen::Vector3d middle;
  double height;  // of the middle, along `up`
  double area;
  double edge;
  bool faces_up;
  bool faces_down;
};

// How much of the mesh faces upwards at each height.
class HeightHistogram {
 public:
  HeightHistogram(const TriangleMesh& mesh, const Eigen::Vector3d& up) {
    Eigen::AlignedBox3d box;
    double highest = -lowest_;
    for (const Eigen::Vector3f& vertex : mesh.vertices) {
      box.extend(vertex.cast<double>());
      const double height = up.dot(vertex.cast<double>());
      lowest_ = std::min(lowest_, height);
      highest = std::max(highest, height);
    }
    if (!box.isEmpty()) bin_ = box.sizes().maxCoeff() / kBinsPerSide;
    if (!(bin_ > 0)) return;
    patches_.reserve(mesh.triangles.size());
    const auto last_bin = static_cast<int>((highest - lowest_) / bin_) + 1;
    std::vector<double> bins(last_bin + 1);
    for (const Triangle& triangle : mesh.triangles) {
      std::array<Eigen::Vector3d, 3> corners;
      for (int i = 0; i < 3; ++i) corners[i] = mesh.vertices[triangle[i]].cast<double>();
      const Eigen::Vector3d normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
      Patch patch;
      patch.area = normal.norm() / 2;
      patch.faces_up = up.dot(normal) / 2 > kMinCosine * patch.area;
      patch.faces_down = up.dot(normal) / 2 < kUndersideCosine * patch.area;
      patch.middle = (corners[0] + corners[1] + corners[2]) / 3;
      patch.height = up.dot(corners[0] + corners[1] + corners[2]) / 3;
      patch.edge = (corners[1] - corners[0]).norm();
      total_area_ += patch.area;
      patches_.push_back(patch);
      if (!patch.faces_up) continue;
      bins[std::clamp(static_cast<int>((patch.height - lowest_) / bin_), 0, last_bin)] += patch.area;
    }
    // Five bins together: half a percent of the mesh.
    windows_.resize(bins.size());
    for (int i = 0; i < static_cast<int>(bins.size()); ++i) {
      for (int j = std::max(0, i - 2); j <= std::min(static_cast<int>(bins.size()) - 1, i + 2); ++j) {
        windows_[i] += bins[j];
      }
    }
  }

  const std::vector<Patch>& patches() const { return patches_; }
  const std::vector<double>& windows() const { return windows_; }
  double total_area() const { return total_area_; }

  // The surface around the peak.
  DiscSurface At(size_t peak) const {
    const double middle = lowest_ + (static_cast<double>(peak) + 0.5) * bin_;
    DiscSurface disc;
    double sum_offset = 0;
    double sum_edge = 0;
    double sum_square = 0;
    for (const Patch& patch : patches_) {
      const double offset = patch.height - middle;
      if (!patch.faces_up || std::abs(offset) > 5 * bin_) continue;
      disc.area += patch.area;
      sum_offset += patch.area * offset;
      sum_square += patch.area * offset * offset;
      sum_edge += patch.area * patch.edge;
    }
    const double mean = sum_offset / disc.area;
    disc.height = middle + mean;
    disc.sigma = std::sqrt(std::max(0.0, sum_square / disc.area - mean * mean));
    disc.mean_edge = sum_edge / disc.area;
    return disc;
  }

 private:
  double lowest_ = std::numeric_limits<double>::infinity();
  double bin_ = 0;
  double total_area_ = 0;
  std::vector<Patch> patches_;
  std::vector<double> windows_;
};

double Radius(const Eigen::Vector3d& x) { return x.head<2>().norm(); }

// Where the area on the plane within a radius, less that below, is greatest. \param patches  by their radius.
// \return  that score.
double FindRim(const std::vector<Patch>& patches, TableTop* table) {
  double best_score = 0;
  double score = 0;
  for (const Patch& patch : patches) {
    const double above = patch.middle.z() - table->disc.height;
    if (above > table->disc.Tolerance()) continue;
    // What is below and faces no camera from above may be the table's own underside, or hide inside it.
    const bool is_below = above < -table->disc.Tolerance();
    if (is_below && !patch.faces_up) continue;
    score += is_below ? -patch.area : patch.area;
    if (score <= best_score) continue;
    best_score = score;
    table->radius = Radius(patch.middle) + table->disc.mean_edge;
  }
  return best_score;
}

// The wall of a can begins where its lid ends, so it is looked for a little beyond the rim.
bool IsBorneOut(const std::vector<Patch>& patches, const TableTop& table) {
  double above = 0;
  double on = 0;
  double below = 0;
  for (const Patch& patch : patches) {
    if (Radius(patch.middle) > table.radius + table.disc.Tolerance()) continue;
    const double height = patch.middle.z() - table.disc.height;
    if (height < -table.disc.Tolerance() && patch.faces_down) continue;
    double& area = height > table.disc.Tolerance() ? above : height < -table.disc.Tolerance() ? below : on;
    area += patch.area;
  }
  return on > below && above > below;
}

}  // namespace

std::optional<DiscSurface> FindDisc(const TriangleMesh& mesh, const Eigen::Vector3d& up) {
  const HeightHistogram heights(mesh, up);
  const std::vector<double>& windows = heights.windows();
  if (windows.empty()) return std::nullopt;
  const double largest = *std::max_element(windows.begin(), windows.end());
  if (!(largest > 0) || largest < kMinAreaShare * heights.total_area()) return std::nullopt;
  // The lowest peak that is large enough.
  size_t peak = 0;
  while (windows[peak] < kNearlyAsLarge * largest) ++peak;
  while (peak + 1 < windows.size() && windows[peak + 1] >= windows[peak]) ++peak;
  return heights.At(peak);
}

std::optional<TableTop> FindTableTop(const TriangleMesh& mesh) {
  const HeightHistogram heights(mesh, Eigen::Vector3d::UnitZ());
  const std::vector<double>& windows = heights.windows();
  std::vector<Patch> patches = heights.patches();
  std::stable_sort(patches.begin(), patches.end(),
                   [](const Patch& a, const Patch& b) { return Radius(a.middle) < Radius(b.middle); });
  std::optional<TableTop> best;
  double best_score = 0;
  for (size_t i = 0; i < windows.size(); ++i) {
    const bool is_peak = windows[i] > 0 && windows[i] >= kMinAreaShare * heights.total_area() &&
                         (i == 0 || windows[i] > windows[i - 1]) &&
                         (i + 1 == windows.size() || windows[i] >= windows[i + 1]);
    if (!is_peak) continue;
    TableTop table;
    table.disc = heights.At(i);
    const double table_score = FindRim(patches, &table);
    if (table_score <= best_score || !IsBorneOut(patches, table)) continue;
    best_score = table_score;
    best = table;
  }
  return best;
}

int64_t CutAtTable(const TableTop& table, TriangleMesh* mesh) {
  const auto before = static_cast<int64_t>(mesh->triangles.size());
  CutBelow(table.disc.height - table.disc.Tolerance(), mesh);
  const double top = table.disc.CutHeight();
  TriangleMesh standing;  // the triangles above the plane alone, to see which hang together
  standing.vertices = mesh->vertices;
  std::vector<size_t> places;
  std::vector<bool> keep(mesh->triangles.size());
  const auto middle = [&](const Triangle& triangle) -> Eigen::Vector3d {
    return (mesh->vertices[triangle[0]] + mesh->vertices[triangle[1]] + mesh->vertices[triangle[2]])
               .cast<double>() /
           3;
  };
  for (size_t t = 0; t < mesh->triangles.size(); ++t) {
    const Eigen::Vector3d x = middle(mesh->triangles[t]);
    keep[t] = Radius(x) <= table.radius;
    if (x.z() <= top) continue;
    places.push_back(t);
    standing.triangles.push_back(mesh->triangles[t]);
  }
  const std::vector<int> parts = ClusterOfTriangles(standing);
  const int num_parts = parts.empty() ? 0 : *std::max_element(parts.begin(), parts.end()) + 1;
  std::vector<Eigen::Vector3d> sums(num_parts, Eigen::Vector3d::Zero());
  std::vector<double> areas(num_parts);
  for (size_t i = 0; i < places.size(); ++i) {
    const Triangle& triangle = standing.triangles[i];
    const Eigen::Vector3f a = mesh->vertices[triangle[0]];
    const double area =
        (mesh->vertices[triangle[1]] - a).cross(mesh->vertices[triangle[2]] - a).cast<double>().norm();
    areas[parts[i]] += area;
    sums[parts[i]] += area * middle(triangle);
  }
  for (size_t i = 0; i < places.size(); ++i) {
    keep[places[i]] = Radius(sums[parts[i]]) <= table.radius * areas[parts[i]];
  }
  KeepTriangles(keep, mesh);
  return before - static_cast<int64_t>(mesh->triangles.size());
}

}  // namespace s2gs
