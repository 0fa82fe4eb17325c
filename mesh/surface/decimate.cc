#include "mesh/surface/decimate.h"

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <limits>
#include <queue>
#include <tuple>
#include <utility>
#include <vector>

#include "mesh/surface/mesh_cleanup.h"

namespace s2gs {
namespace {

// The weighted sum of squared distances to planes, x' a x - 2 b' x + c.
struct Quadric {
  Eigen::Matrix3d a = Eigen::Matrix3d::Zero();
  Eigen::Vector3d b = Eigen::Vector3d::Zero();
  double c = 0;
  double weight = 0;  // of all planes

  void AddPlane(const Eigen::Vector3d& normal, const Eigen::Vector3d& point, double plane_weight) {
    const double offset = normal.dot(point);
    a += plane_weight * normal * normal.transpose();
    b += plane_weight * offset * normal;
    c += plane_weight * offset * offset;
    weight += plane_weight;
  }
  Quadric& operator+=(const Quadric& other) {
    a += other.a;
    b += other.b;
    c += other.c;
    weight += other.weight;
    return *this;
  }
  double At(const Eigen::Vector3d& x) const { return std::max(0.0, x.dot(a * x) - 2 * b.dot(x) + c); }
};

struct Collapse {
  double cost;
  uint32_t keep;
  uint32_t drop;
  uint32_t keep_version;
  uint32_t drop_version;

  // Cheapest first in a queue; ties in the order of the vertices.
  bool operator<(const Collapse& other) const {
    return std::tie(other.cost, other.keep, other.drop) < std::tie(cost, keep, drop);
  }
};

// How much more an outline resists than a surface.
constexpr double kOutlineWeight = 10;
// Pulls vertices of flat regions, where any point of the plane will do, to the edge's middle.
constexpr double kPull = 1e-6;

class Decimator {
 public:
  explicit Decimator(TriangleMesh* mesh) : mesh_(*mesh) {
    Eigen::AlignedBox3d box;
    for (const Eigen::Vector3f& vertex : mesh_.vertices) box.extend(vertex.cast<double>());
    // The quadrics lose digits far from the origin.
    middle_ = box.center();
    scale_ = std::max(box.sizes().maxCoeff(), 1e-300);
    positions_.reserve(mesh_.vertices.size());
    for (const Eigen::Vector3f& vertex : mesh_.vertices) {
      positions_.emplace_back((vertex.cast<double>() - middle_) / scale_);
    }
    quadrics_.resize(positions_.size());
    versions_.resize(positions_.size());
    triangles_of_.resize(positions_.size());
    is_alive_.assign(mesh_.triangles.size(), true);
    AddQuadrics();
  }

  // \param max_error  as SimplifyMesh's; infinite: no bound.
  void Run(int64_t max_triangles, double max_error) {
    max_error_sq_ = max_error / scale_ * (max_error / scale_);
    auto count = static_cast<int64_t>(mesh_.triangles.size());
    for (uint32_t v = 0; v < positions_.size(); ++v) {
      for (const uint32_t neighbour : Neighbours(v)) {
        if (v < neighbour) Push(v, neighbour);
      }
    }
    while (count > max_triangles && !queue_.empty()) {
      const Collapse next = queue_.top();
      queue_.pop();
      if (versions_[next.keep] != next.keep_version || versions_[next.drop] != next.drop_version) continue;
      if (IsAllowed(next.keep, next.drop)) count -= Apply(next.keep, next.drop);
    }
    for (size_t v = 0; v < positions_.size(); ++v) {
      mesh_.vertices[v] = (middle_ + scale_ * positions_[v]).cast<float>();
    }
    mesh_.normals.clear();
    KeepTriangles(is_alive_, &mesh_);
  }

 private:
  static bool Has(const Triangle& triangle, uint32_t v) { return (triangle.array() == v).any(); }

  void AddQuadrics() {
    for (uint32_t t = 0; t < mesh_.triangles.size(); ++t) {
      for (int i = 0; i < 3; ++i) triangles_of_[mesh_.triangles[t][i]].push_back(t);
    }
    for (const Triangle& triangle : mesh_.triangles) {
      const Eigen::Vector3d& x = positions_[triangle[0]];
      const Eigen::Vector3d normal = (positions_[triangle[1]] - x).cross(positions_[triangle[2]] - x);
      const double area = normal.norm() / 2;
      if (!(area > 0)) continue;
      Quadric quadric;
      quadric.AddPlane(normal / (2 * area), x, area);
      for (int i = 0; i < 3; ++i) {
        quadrics_[triangle[i]] += quadric;
        const uint32_t from = triangle[i];
        const uint32_t to = triangle[(i + 1) % 3];
        if (SharedTriangles(from, to) != 1) continue;
        const Eigen::Vector3d edge = positions_[to] - positions_[from];
        Quadric outline;
        outline.AddPlane(edge.cross(normal).normalized(), positions_[from],
                         kOutlineWeight * edge.squaredNorm());
        quadrics_[from] += outline;
        quadrics_[to] += outline;
      }
    }
  }

  int SharedTriangles(uint32_t v, uint32_t w) const {
    return static_cast<int>(std::count_if(triangles_of_[v].begin(), triangles_of_[v].end(),
                                          [&](uint32_t t) { return Has(mesh_.triangles[t], w); }));
  }

  // Sorted.
  std::vector<uint32_t> Neighbours(uint32_t v) const {
    std::vector<uint32_t> neighbours;
    neighbours.reserve(2 * triangles_of_[v].size());
    for (const uint32_t t : triangles_of_[v]) {
      for (int i = 0; i < 3; ++i) {
        if (mesh_.triangles[t][i] != v) neighbours.push_back(mesh_.triangles[t][i]);
      }
    }
    std::sort(neighbours.begin(), neighbours.end());
    neighbours.erase(std::unique(neighbours.begin(), neighbours.end()), neighbours.end());
    return neighbours;
  }

  Quadric Sum(uint32_t v, uint32_t w) const {
    Quadric sum = quadrics_[v];
    sum += quadrics_[w];
    return sum;
  }

  Eigen::Vector3d Target(uint32_t v, uint32_t w) const {
    const Quadric sum = Sum(v, w);
    const Eigen::Vector3d middle = (positions_[v] + positions_[w]) / 2;
    const double pull = kPull * sum.a.trace() + 1e-300;
    const Eigen::Matrix3d matrix = sum.a + pull * Eigen::Matrix3d::Identity();
    const Eigen::Vector3d best = matrix.inverse() * (sum.b + pull * middle);
    // Never far from the edge, whatever rounding does.
    const double reach = (positions_[v] - positions_[w]).norm();
    return best.allFinite() && (best - middle).norm() <= 2 * reach ? best : middle;
  }

  void Push(uint32_t v, uint32_t w) {
    const uint32_t keep = std::min(v, w);
    const uint32_t drop = std::max(v, w);
    queue_.push({Sum(v, w).At(Target(keep, drop)), keep, drop, versions_[keep], versions_[drop]});
  }

  bool IsOnOutline(uint32_t v) const {
    for (const uint32_t neighbour : Neighbours(v)) {
      if (SharedTriangles(v, neighbour) != 2) return true;
    }
    return false;
  }

  // Whether a triangle around `v` but not around `other` turns over or loses its area when v moves to x.
  bool TurnsOver(uint32_t v, uint32_t other, const Eigen::Vector3d& x) const {
    for (const uint32_t t : triangles_of_[v]) {
      const Triangle& triangle = mesh_.triangles[t];
      if (Has(triangle, other)) continue;
      std::array<Eigen::Vector3d, 3> before;
      std::array<Eigen::Vector3d, 3> after;
      for (int i = 0; i < 3; ++i) {
        before[i] = positions_[triangle[i]];
        after[i] = triangle[i] == v ? x : before[i];
      }
      const Eigen::Vector3d old_normal = (before[1] - before[0]).cross(before[2] - before[0]);
      const Eigen::Vector3d new_normal = (after[1] - after[0]).cross(after[2] - after[0]);
      const double longest =
          std::max({(after[1] - after[0]).squaredNorm(), (after[2] - after[0]).squaredNorm(),
                    (after[2] - after[1]).squaredNorm()});
      if (new_normal.norm() < 1e-3 * longest) return true;
      if (old_normal.dot(new_normal) < 0.2 * old_normal.norm() * new_normal.norm()) return true;
    }
    return false;
  }

  bool IsTooFar(const Quadric& quadric, const Eigen::Vector3d& x) const {
    return quadric.At(x) > max_error_sq_ * quadric.weight;
  }

  bool IsAllowed(uint32_t keep, uint32_t drop) const {
    const int shared = SharedTriangles(keep, drop);
    if (shared < 1 || shared > 2) return false;
    const std::vector<uint32_t> around_keep = Neighbours(keep);
    const std::vector<uint32_t> around_drop = Neighbours(drop);
    std::vector<uint32_t> common;
    std::set_intersection(around_keep.begin(), around_keep.end(), around_drop.begin(), around_drop.end(),
                          std::back_inserter(common));
    // Link condition: only the shared triangles may close up.
    if (static_cast<int>(common.size()) != shared) return false;
    if (around_keep.size() <= 3 && around_drop.size() <= 3) return false;
    // An inner edge between two outlines would pinch the surface.
    if (shared == 2 && IsOnOutline(keep) && IsOnOutline(drop)) return false;
    const Eigen::Vector3d x = Target(keep, drop);
    // Each side by itself: the planes of a large one would hide what becomes of a small one.
    if (IsTooFar(quadrics_[keep], x) || IsTooFar(quadrics_[drop], x)) return false;
    return !TurnsOver(keep, drop, x) && !TurnsOver(drop, keep, x);
  }

  int Apply(uint32_t keep, uint32_t drop) {
    const Eigen::Vector3d x = Target(keep, drop);
    if (!mesh_.colors.empty()) {
      const Eigen::Vector3d edge = positions_[drop] - positions_[keep];
      const double share =
          std::clamp((x - positions_[keep]).dot(edge) / std::max(edge.squaredNorm(), 1e-300), 0.0, 1.0);
      const Eigen::Array3d color = (1 - share) * mesh_.colors[keep].cast<double>().array() +
                                   share * mesh_.colors[drop].cast<double>().array() + 0.5;
      mesh_.colors[keep] = color.cast<uint8_t>().matrix();
    }
    positions_[keep] = x;
    quadrics_[keep] += quadrics_[drop];
    int num_gone = 0;
    for (const uint32_t t : triangles_of_[drop]) {
      Triangle& triangle = mesh_.triangles[t];
      if (Has(triangle, keep)) {
        is_alive_[t] = false;
        ++num_gone;
        for (int i = 0; i < 3; ++i) {
          if (triangle[i] == drop) continue;
          std::vector<uint32_t>& list = triangles_of_[triangle[i]];
          list.erase(std::find(list.begin(), list.end(), t));
        }
        continue;
      }
      for (int i = 0; i < 3; ++i) {
        if (triangle[i] == drop) triangle[i] = keep;
      }
      triangles_of_[keep].push_back(t);
    }
    triangles_of_[drop] = {};
    ++versions_[drop];
    ++versions_[keep];
    for (const uint32_t neighbour : Neighbours(keep)) Push(keep, neighbour);
    return num_gone;
  }

  TriangleMesh& mesh_;
  Eigen::Vector3d middle_;
  double scale_ = 1;
  double max_error_sq_ = 0;
  std::vector<Eigen::Vector3d> positions_;  // from the middle, in sizes of the mesh
  std::vector<Quadric> quadrics_;
  std::vector<uint32_t> versions_;
  std::vector<std::vector<uint32_t>> triangles_of_;
  std::vector<bool> is_alive_;
  std::priority_queue<Collapse> queue_;
};

}  // namespace

void DecimateMesh(int64_t max_triangles, TriangleMesh* mesh) {
  if (static_cast<int64_t>(mesh->triangles.size()) <= max_triangles) return;
  Decimator(mesh).Run(max_triangles, std::numeric_limits<double>::infinity());
}

void SimplifyMesh(double max_error, TriangleMesh* mesh) {
  if (!(max_error > 0)) return;
  Decimator(mesh).Run(0, max_error);
}

}  // namespace s2gs
