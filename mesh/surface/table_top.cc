#include "mesh/surface/table_top.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "mesh/surface/mesh_cleanup.h"
#include "sfm_split/base/angles.h"

namespace s2gs {
namespace {

constexpr int kBinsPerSide = 1000;
constexpr double kMinCosine = 0.95;
// What looks up or down by more than walls lean is ground, or an underside.
constexpr double kGroundCosine = 0.5;
constexpr double kMinAreaShare = 0.02;
constexpr double kNearlyAsLarge = 0.3;
constexpr int kDirections = 36;
constexpr double kMinWallShare = 0.25;  // of the mean over directions: a square's sides vary by half.

// A triangle.
struct Patch {
  Eigen::Vector3d middle;
  double height;  // of the middle, along `up`
  double area;
  double edge;
  bool faces_up;
  bool is_wall;
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
      patch.faces_down = up.dot(normal) / 2 < -kGroundCosine * patch.area;
      patch.is_wall = std::abs(up.dot(normal)) / 2 < kGroundCosine * patch.area;
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

// Whether the plane has more than what lies below it, and what stands on it more than the walls of a body
// below and what a top that reaches so far in would hide. The wall of a can begins where its lid ends, so it
// is looked for a little beyond the rim. \param patches  by their radius.
bool IsBorneOut(const std::vector<Patch>& patches, const TableTop& table) {
  const double tolerance = table.disc.Tolerance();
  const auto is_within = [&](const Patch& patch) { return Radius(patch.middle) <= table.radius + tolerance; };
  const auto height = [&](const Patch& patch) { return patch.middle.z() - table.disc.height; };
  double on = 0;
  for (const Patch& patch : patches) {
    if (is_within(patch) && std::abs(height(patch)) <= tolerance) on += patch.area;
  }
  double above = 0;
  double below = 0;
  double hidden_or_walls = 0;
  double on_further_in = 0;
  for (const Patch& patch : patches) {
    if (!is_within(patch)) break;
    if (height(patch) > tolerance) {
      above += patch.area;
    } else if (height(patch) >= -tolerance) {
      on_further_in += patch.area;
    } else if (!patch.faces_down) {
      below += patch.area;
      if (patch.is_wall || 2 * on_further_in < on) hidden_or_walls += patch.area;
    }
  }
  return on > below && above > hidden_or_walls;
}

Eigen::Vector3d Middle(const TriangleMesh& mesh, const Triangle& triangle) {
  const Eigen::Vector3f sum =
      mesh.vertices[triangle[0]] + mesh.vertices[triangle[1]] + mesh.vertices[triangle[2]];
  return sum.cast<double>() / 3;
}

// Connected triangles of a mesh.
struct Part {
  std::vector<size_t> triangles;
  double area = 0;
  Eigen::Vector3d moment = Eigen::Vector3d::Zero();  // of the area
  double upwards = 0;   // the area that it shows from above, less that from below
  double outwards = 0;  // the same from around the axis
  std::array<double, kDirections> outwards_in = {};  // of this, by direction

  Eigen::Vector3d Centre() const { return moment / area; }
  // The side of a body that goes on below the plane: it stands upright all around it.
  bool IsSide() const {
    const auto num_walls = std::count_if(outwards_in.begin(), outwards_in.end(), [&](double there) {
      return there > kMinWallShare * outwards / kDirections;
    });
    return outwards > std::abs(upwards) && 2 * num_walls >= kDirections;
  }
};

std::vector<Part> PartsOf(const TriangleMesh& mesh, const std::vector<size_t>& triangles) {
  TriangleMesh alone;
  alone.vertices = mesh.vertices;
  for (const size_t t : triangles) alone.triangles.push_back(mesh.triangles[t]);
  const std::vector<int> numbers = ClusterOfTriangles(alone);
  std::vector<Part> parts(numbers.empty() ? 0 : *std::max_element(numbers.begin(), numbers.end()) + 1);
  for (size_t i = 0; i < triangles.size(); ++i) {
    Part& part = parts[numbers[i]];
    const Eigen::Vector3d a = mesh.vertices[alone.triangles[i][0]].cast<double>();
    const Eigen::Vector3d b = mesh.vertices[alone.triangles[i][1]].cast<double>();
    const Eigen::Vector3d c = mesh.vertices[alone.triangles[i][2]].cast<double>();
    const Eigen::Vector3d normal = (b - a).cross(c - a) / 2;
    const Eigen::Vector3d middle = (a + b + c) / 3;
    part.triangles.push_back(triangles[i]);
    part.area += normal.norm();
    part.moment += normal.norm() * middle;
    part.upwards += normal.z();
    if (!(Radius(middle) > 0)) continue;
    const double outwards = normal.head<2>().dot(middle.head<2>()) / Radius(middle);
    const double turn = std::atan2(middle.y(), middle.x()) / (2 * kPi) + 0.5;
    part.outwards += outwards;
    part.outwards_in[std::min(static_cast<int>(turn * kDirections), kDirections - 1)] += outwards;
  }
  return parts;
}

// Whether a side joins both planes.
bool IsBaseOn(const TriangleMesh& mesh, const TableTop& base, const TableTop& table) {
  std::vector<size_t> between;
  for (size_t t = 0; t < mesh.triangles.size(); ++t) {
    const Eigen::Vector3d middle = Middle(mesh, mesh.triangles[t]);
    if (middle.z() > table.disc.CutHeight() && middle.z() < base.disc.height - base.disc.Tolerance() &&
        Radius(middle) < table.radius) {
      between.push_back(t);
    }
  }
  const std::vector<Part> parts = PartsOf(mesh, between);
  return std::any_of(parts.begin(), parts.end(), [](const Part& part) { return part.IsSide(); });
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
  std::vector<TableTop> tables;  // from the lowest on
  std::vector<double> scores;
  for (size_t i = 0; i < windows.size(); ++i) {
    const bool is_peak = windows[i] > 0 && windows[i] >= kMinAreaShare * heights.total_area() &&
                         (i == 0 || windows[i] > windows[i - 1]) &&
                         (i + 1 == windows.size() || windows[i] >= windows[i + 1]);
    if (!is_peak) continue;
    TableTop table;
    table.disc = heights.At(i);
    const double score = FindRim(patches, &table);
    if (!(score > 0) || !IsBorneOut(patches, table)) continue;
    tables.push_back(table);
    scores.push_back(score);
  }
  if (tables.empty()) return std::nullopt;
  const size_t best = std::max_element(scores.begin(), scores.end()) - scores.begin();
  for (size_t i = 0; i < best; ++i) {
    if (scores[i] >= kNearlyAsLarge * scores[best] && IsBaseOn(mesh, tables[best], tables[i]))
      return tables[i];
  }
  return tables[best];
}

std::vector<bool> StandsOnTable(const TableTop& table, const TriangleMesh& mesh) {
  const double top = table.disc.CutHeight();
  const double bottom = table.disc.height - table.disc.Tolerance();
  std::vector<size_t> standing;
  std::vector<size_t> beside;
  for (size_t t = 0; t < mesh.triangles.size(); ++t) {
    const Eigen::Vector3d middle = Middle(mesh, mesh.triangles[t]);
    if (middle.z() > top) {
      standing.push_back(t);
    } else if (middle.z() < bottom || Radius(middle) > table.radius) {
      beside.push_back(t);
    }
  }
  std::vector<bool> keep(mesh.triangles.size(), true);
  const auto drop = [&](const Part& part) {
    for (const size_t t : part.triangles) keep[t] = false;
  };
  for (const Part& part : PartsOf(mesh, standing)) {
    if (part.area > 0 && Radius(part.Centre()) > table.radius) drop(part);
  }
  for (const Part& part : PartsOf(mesh, beside)) {
    if (!part.IsSide()) drop(part);
  }
  return keep;
}

int64_t CutAtTable(const TableTop& table, TriangleMesh* mesh) {
  const auto before = static_cast<int64_t>(mesh->triangles.size());
  KeepTriangles(StandsOnTable(table, *mesh), mesh);
  return before - static_cast<int64_t>(mesh->triangles.size());
}

}  // namespace s2gs
