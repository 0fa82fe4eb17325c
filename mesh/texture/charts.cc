#include "mesh/texture/charts.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <deque>
#include <limits>
#include <numeric>
#include <unordered_map>
#include <utility>

#include "mesh/texture/texel_raster.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

constexpr uint32_t kNoChart = std::numeric_limits<uint32_t>::max();
// Between the chart's direction and the smoothed normals: 45 degrees, at which a texel is 1.4 long.
constexpr float kMinSmoothCosine = 0.70710678F;
// A triangle of a rough surface may stand steeper than its surroundings, but not on edge: from here on its
// texels would be more than five long.
constexpr float kMinCosine = 0.2F;
// Rounds in which normals are averaged with their neighbours': the roughness of a mesh of depth maps is that
// of single edges.
constexpr int kSmoothingRounds = 4;
// A triangle may lie over others of its chart that are no farther away on the mesh than so many texels: what
// it shows then is that close to what it should show. Rough meshes are full of small triangles that lean over
// their neighbours.
constexpr float kNearTexels = 4;
// Charts of fewer triangles go to their neighbours where these can take them.
constexpr size_t kFewTriangles = 16;
// Turns that are tried for the smallest box around a chart.
constexpr int kNumTurns = 12;

using Neighbors = std::array<uint32_t, 3>;

// The triangles across the three edges, or kNoChart. Edges of more than two triangles are borders.
std::vector<Neighbors> FindNeighbors(const TriangleMesh& mesh) {
  struct Edge {
    uint64_t key;
    uint32_t triangle;
    uint8_t side;
  };
  std::vector<Edge> edges;
  edges.reserve(3 * mesh.triangles.size());
  for (size_t t = 0; t < mesh.triangles.size(); ++t) {
    for (int side = 0; side < 3; ++side) {
      const uint64_t a = mesh.triangles[t][side];
      const uint64_t b = mesh.triangles[t][(side + 1) % 3];
      edges.push_back(
          {std::min(a, b) << 32 | std::max(a, b), static_cast<uint32_t>(t), static_cast<uint8_t>(side)});
    }
  }
  std::sort(edges.begin(), edges.end(), [](const Edge& a, const Edge& b) {
    return a.key != b.key ? a.key < b.key : a.triangle < b.triangle;
  });
  std::vector<Neighbors> neighbors(mesh.triangles.size(), {kNoChart, kNoChart, kNoChart});
  for (size_t begin = 0; begin < edges.size();) {
    size_t end = begin + 1;
    while (end < edges.size() && edges[end].key == edges[begin].key) ++end;
    if (end - begin == 2) {
      neighbors[edges[begin].triangle][edges[begin].side] = edges[begin + 1].triangle;
      neighbors[edges[begin + 1].triangle][edges[begin + 1].side] = edges[begin].triangle;
    }
    begin = end;
  }
  return neighbors;
}

class ChartMaker {
 public:
  ChartMaker(const TriangleMesh& mesh, const ChartOptions& options)
      : mesh_(mesh),
        options_(options),
        neighbors_(FindNeighbors(mesh)),
        chart_of_(mesh.triangles.size(), kNoChart) {
    // With half a texel to spare at either end.
    max_extent_ = static_cast<float>((options.max_side - 2 * options.gutter - 2) * options.texel_size);
    S2GS_INVARIANT(max_extent_ > 0);
    ComputeNormals();
  }

  std::vector<Chart> Make() {
    std::vector<uint32_t> seeds(mesh_.triangles.size());
    std::iota(seeds.begin(), seeds.end(), 0U);
    std::stable_sort(seeds.begin(), seeds.end(),
                     [&](uint32_t a, uint32_t b) { return bends_[a] < bends_[b]; });
    for (const uint32_t seed : seeds) {
      if (chart_of_[seed] == kNoChart && !IsDegenerate(seed)) Grow(seed);
    }
    GiveAwaySmall();
    std::vector<Chart> charts;
    // Charts whose triangles lie over each other leave some of them to further ones.
    std::deque<std::pair<std::vector<uint32_t>, Eigen::Vector3f>> waiting;
    for (auto& region : regions_) {
      if (!region.triangles.empty()) waiting.emplace_back(std::move(region.triangles), region.direction);
    }
    while (!waiting.empty()) {
      auto [triangles, direction] = std::move(waiting.front());
      waiting.pop_front();
      std::vector<uint32_t> left_over;
      Chart chart = Lay(std::move(triangles), direction, &left_over);
      if (!chart.triangles.empty()) charts.push_back(std::move(chart));
      for (std::vector<uint32_t>& part : ConnectedParts(left_over)) {
        waiting.emplace_back(std::move(part), direction);
      }
    }
    return charts;
  }

 private:
  struct Region {
    std::vector<uint32_t> triangles;
    Eigen::Vector3f direction;
  };

  bool IsDegenerate(uint32_t t) const {
    const Triangle& triangle = mesh_.triangles[t];
    return triangle[0] == triangle[1] || triangle[1] == triangle[2] || triangle[2] == triangle[0];
  }

  // Too small for its own direction to matter.
  bool IsSmall(uint32_t t) const {
    const Triangle& corners = mesh_.triangles[t];
    const auto reach = static_cast<float>(kNearTexels * options_.texel_size);
    for (int i = 0; i < 3; ++i) {
      const Eigen::Vector3f edge = mesh_.vertices[corners[i]] - mesh_.vertices[corners[(i + 1) % 3]];
      if (edge.squaredNorm() > reach * reach) return false;
    }
    return true;
  }

  Eigen::Vector3f Middle(uint32_t t) const {
    const Triangle& corners = mesh_.triangles[t];
    return (mesh_.vertices[corners[0]] + mesh_.vertices[corners[1]] + mesh_.vertices[corners[2]]) / 3;
  }

  void ComputeNormals() {
    const auto unit = [](const Eigen::Vector3f& v) {
      const float norm = v.norm();
      return norm > 0 ? Eigen::Vector3f(v / norm) : Eigen::Vector3f(Eigen::Vector3f::UnitZ());
    };
    const size_t count = mesh_.triangles.size();
    normals_.reserve(count);
    for (const Triangle& t : mesh_.triangles) {
      const Eigen::Vector3f& a = mesh_.vertices[t[0]];
      normals_.push_back(unit((mesh_.vertices[t[1]] - a).cross(mesh_.vertices[t[2]] - a)));
    }
    smooth_ = normals_;
    bends_.assign(count, 0);
    std::vector<Eigen::Vector3f> next(count);
    for (int round = 0; round < 2 * kSmoothingRounds; ++round) {
      for (size_t t = 0; t < count; ++t) {
        Eigen::Vector3f sum = smooth_[t];
        for (const uint32_t n : neighbors_[t]) {
          if (n != kNoChart) sum += smooth_[n];
        }
        next[t] = unit(sum);
      }
      std::swap(smooth_, next);
      if (round == kSmoothingRounds - 1) rough_ = smooth_;
    }
    // How much the surface turns between the first and the second half of the rounds.
    for (size_t t = 0; t < count; ++t) bends_[t] = 1 - rough_[t].dot(smooth_[t]);
  }

  bool Faces(uint32_t t, const Eigen::Vector3f& direction) const {
    return rough_[t].dot(direction) >= kMinSmoothCosine &&
           (normals_[t].dot(direction) >= kMinCosine || IsSmall(t));
  }

  void Grow(uint32_t seed) {
    const auto number = static_cast<uint32_t>(regions_.size());
    regions_.push_back({{seed}, smooth_[seed]});
    Region& region = regions_.back();
    // A seed that its surroundings do not face goes by itself.
    if (!Faces(seed, region.direction)) region.direction = normals_[seed];
    chart_of_[seed] = number;
    const Eigen::Vector3f right = region.direction.unitOrthogonal();
    const Eigen::Vector3f down = region.direction.cross(right);
    Eigen::AlignedBox2f box;
    const auto corners_fit = [&](uint32_t t) {
      Eigen::AlignedBox2f larger = box;
      for (int i = 0; i < 3; ++i) {
        const Eigen::Vector3f& x = mesh_.vertices[mesh_.triangles[t][i]];
        larger.extend(Eigen::Vector2f(right.dot(x), down.dot(x)));
      }
      // Whichever way the chart is turned, it fits.
      if (larger.diagonal().norm() > max_extent_) return false;
      box = larger;
      return true;
    };
    corners_fit(seed);
    for (size_t i = 0; i < region.triangles.size(); ++i) {
      for (const uint32_t n : neighbors_[region.triangles[i]]) {
        if (n == kNoChart || chart_of_[n] != kNoChart || IsDegenerate(n) || !Faces(n, region.direction) ||
            !corners_fit(n)) {
          continue;
        }
        chart_of_[n] = number;
        region.triangles.push_back(n);
      }
    }
  }

  void GiveAwaySmall() {
    std::vector<Eigen::AlignedBox3f> boxes(regions_.size());
    for (size_t r = 0; r < regions_.size(); ++r) {
      for (const uint32_t t : regions_[r].triangles) Extend(t, &boxes[r]);
    }
    for (size_t r = 0; r < regions_.size(); ++r) {
      if (regions_[r].triangles.size() >= kFewTriangles) continue;
      std::vector<uint32_t> stay = std::move(regions_[r].triangles);
      regions_[r].triangles.clear();
      for (bool has_moved = true; has_moved && !stay.empty();) {
        has_moved = false;
        std::vector<uint32_t> rest;
        for (const uint32_t t : stay) {
          const uint32_t taker = FindTaker(t, static_cast<uint32_t>(r), boxes);
          if (taker == kNoChart) {
            rest.push_back(t);
            continue;
          }
          Extend(t, &boxes[taker]);
          regions_[taker].triangles.push_back(t);
          chart_of_[t] = taker;
          has_moved = true;
        }
        stay = std::move(rest);
      }
      regions_[r].triangles = std::move(stay);
    }
  }

  void Extend(uint32_t t, Eigen::AlignedBox3f* box) const {
    for (int i = 0; i < 3; ++i) box->extend(mesh_.vertices[mesh_.triangles[t][i]]);
  }

  // The neighbouring region that the triangle faces most, or kNoChart.
  uint32_t FindTaker(uint32_t t, uint32_t own, const std::vector<Eigen::AlignedBox3f>& boxes) const {
    uint32_t best = kNoChart;
    float best_cosine = kMinCosine;
    for (const uint32_t n : neighbors_[t]) {
      if (n == kNoChart) continue;
      const uint32_t r = chart_of_[n];
      if (r == own || r == kNoChart || regions_[r].triangles.empty()) continue;
      const Eigen::Vector3f& normal = IsSmall(t) ? rough_[t] : normals_[t];
      const float cosine = normal.dot(regions_[r].direction);
      Eigen::AlignedBox3f box = boxes[r];
      Extend(t, &box);
      if (cosine < best_cosine || box.diagonal().norm() > max_extent_) continue;
      best = r;
      best_cosine = cosine;
    }
    return best;
  }

  // Projects triangles; those that would cover texels of others are left over.
  Chart Lay(std::vector<uint32_t> triangles, const Eigen::Vector3f& direction,
            std::vector<uint32_t>* left_over) const {
    Chart chart;
    chart.triangles = std::move(triangles);
    ChooseAxes(direction, &chart);
    std::vector<uint32_t> owners(static_cast<size_t>(chart.width) * chart.height, kNoChart);
    const auto reach = static_cast<float>(kNearTexels * options_.texel_size);
    std::vector<uint32_t> kept;
    kept.reserve(chart.triangles.size());
    for (const uint32_t t : chart.triangles) {
      const TexelTriangle corners = CornersOf(t, chart);
      bool is_free = true;
      ForEachTexel(corners, chart.width, chart.height, [&](const Texel& texel) {
        if (!texel.is_inside) return;
        const uint32_t owner = owners[static_cast<size_t>(texel.y) * chart.width + texel.x];
        is_free = is_free && (owner == kNoChart || (Middle(owner) - Middle(t)).norm() <= reach);
      });
      // A first triangle always stays: its own chart has nothing that it could lie over.
      if (!is_free && !kept.empty()) {
        left_over->push_back(t);
        continue;
      }
      ForEachTexel(corners, chart.width, chart.height, [&](const Texel& texel) {
        uint32_t& owner = owners[static_cast<size_t>(texel.y) * chart.width + texel.x];
        if (texel.is_inside && owner == kNoChart) owner = t;
      });
      kept.push_back(t);
    }
    chart.triangles = std::move(kept);
    if (!left_over->empty()) ChooseAxes(direction, &chart);
    return chart;
  }

  TexelTriangle CornersOf(uint32_t t, const Chart& chart) const {
    TexelTriangle corners;
    for (int i = 0; i < 3; ++i) corners[i] = chart.Project(mesh_.vertices[mesh_.triangles[t][i]]);
    return corners;
  }

  // Turns the axes so that the box around the chart is the smallest, and its longer side lies along rows.
  void ChooseAxes(const Eigen::Vector3f& direction, Chart* chart) const {
    // Seen from outside: rows to the right, columns down, the direction towards who looks.
    const Eigen::Vector3f x = direction.unitOrthogonal();
    const Eigen::Vector3f y = x.cross(direction);
    float best_area = std::numeric_limits<float>::infinity();
    Eigen::AlignedBox2f best;
    for (int turn = 0; turn < 2 * kNumTurns; ++turn) {
      const auto angle = static_cast<float>(kPi / 2 * turn / kNumTurns);
      const Eigen::Vector3f right = std::cos(angle) * x + std::sin(angle) * y;
      const Eigen::Vector3f down = std::cos(angle) * y - std::sin(angle) * x;
      Eigen::AlignedBox2f box;
      for (const uint32_t t : chart->triangles) {
        for (int i = 0; i < 3; ++i) {
          const Eigen::Vector3f& vertex = mesh_.vertices[mesh_.triangles[t][i]];
          box.extend(Eigen::Vector2f(right.dot(vertex), down.dot(vertex)));
        }
      }
      const Eigen::Vector2f size = box.diagonal();
      if (size.y() > size.x() || size.x() * size.y() >= best_area) continue;
      best_area = size.x() * size.y();
      chart->right = right;
      chart->down = down;
      best = box;
    }
    // A triangle that is larger than a page by itself has larger texels.
    const auto most = static_cast<float>(options_.max_side - 2 * options_.gutter - 2);
    chart->texel_size = std::max(static_cast<float>(options_.texel_size), best.diagonal().x() / most);
    // Half a texel to spare, so that no corner is nearer to the gutter's end than its width.
    const auto gutter = static_cast<float>(options_.gutter);
    chart->origin = best.min() - Eigen::Vector2f::Constant((gutter + 0.5F) * chart->texel_size);
    const auto side = [&](float length) {
      return static_cast<int>(std::ceil(length / chart->texel_size + 1)) + 2 * options_.gutter;
    };
    chart->width = side(best.diagonal().x());
    chart->height = side(best.diagonal().y());
    S2GS_INVARIANT(chart->width > 0 && chart->width <= options_.max_side &&
                   chart->height <= options_.max_side);
  }

  std::vector<std::vector<uint32_t>> ConnectedParts(const std::vector<uint32_t>& triangles) const {
    std::unordered_map<uint32_t, bool> is_waiting;
    for (const uint32_t t : triangles) is_waiting[t] = true;
    std::vector<std::vector<uint32_t>> parts;
    for (const uint32_t seed : triangles) {
      if (!std::exchange(is_waiting[seed], false)) continue;
      std::vector<uint32_t> part = {seed};
      for (size_t i = 0; i < part.size(); ++i) {
        for (const uint32_t n : neighbors_[part[i]]) {
          const auto found = is_waiting.find(n);
          if (found == is_waiting.end() || !std::exchange(found->second, false)) continue;
          part.push_back(n);
        }
      }
      parts.push_back(std::move(part));
    }
    return parts;
  }

  const TriangleMesh& mesh_;
  const ChartOptions& options_;
  std::vector<Neighbors> neighbors_;
  std::vector<uint32_t> chart_of_;
  std::vector<Eigen::Vector3f> normals_;  // of the triangles
  std::vector<Eigen::Vector3f> rough_;    // smoothed a little
  std::vector<Eigen::Vector3f> smooth_;   // smoothed twice as often
  std::vector<float> bends_;
  std::vector<Region> regions_;
  float max_extent_ = 0;
};

}  // namespace

std::vector<Chart> MakeCharts(const TriangleMesh& mesh, const ChartOptions& options) {
  return ChartMaker(mesh, options).Make();
}

}  // namespace s2gs
