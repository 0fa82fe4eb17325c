#include "sfm_split/unmoved_keypoints.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

namespace s2gs {
namespace {

using Cell = std::pair<int, int>;

// Keypoints by square cells.
class Grid {
 public:
  Grid(const Keypoints& keypoints, const std::vector<bool>& usable, float cell)
      : keypoints_(keypoints), cell_(cell) {
    for (uint32_t k = 0; k < keypoints.size(); ++k) {
      if (usable[k]) cells_.push_back({CellOf(keypoints[k]), k});
    }
    std::sort(cells_.begin(), cells_.end());
  }
  template <typename Visit>
  void ForEachNear(const Eigen::Vector2f& at, const Visit& visit) const {
    const Cell middle = CellOf(at);
    for (int dx = -1; dx <= 1; ++dx) {
      const Cell first{middle.first + dx, middle.second - 1};
      auto entry = std::lower_bound(cells_.begin(), cells_.end(), std::make_pair(first, 0U));
      for (; entry != cells_.end() && entry->first <= Cell{first.first, first.second + 2}; ++entry) {
        visit(entry->second);
      }
    }
  }

 private:
  Cell CellOf(const Eigen::Vector2f& at) const {
    return {static_cast<int>(std::floor(at.x() / cell_)), static_cast<int>(std::floor(at.y() / cell_))};
  }
  const Keypoints& keypoints_;
  float cell_;
  std::vector<std::pair<Cell, uint32_t>> cells_;
};

float MedianOf(std::vector<float> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

Eigen::Vector2f CommonShift(const Keypoints& keypoints, const std::vector<uint32_t>& chosen,
                            const Keypoints& others, const std::vector<bool>& usable, float max_shake_px) {
  const Grid grid(others, usable, max_shake_px);
  std::map<Cell, std::vector<Eigen::Vector2f>> displacements;
  for (const uint32_t k : chosen) {
    grid.ForEachNear(keypoints[k], [&](uint32_t other) {
      const Eigen::Vector2f d = others[other] - keypoints[k];
      if (d.norm() > max_shake_px) return;
      displacements[{static_cast<int>(std::lround(d.x())), static_cast<int>(std::lround(d.y()))}].push_back(
          d);
    });
  }
  const std::vector<Eigen::Vector2f>* most = nullptr;
  for (const auto& [cell, all] : displacements) {
    if (most == nullptr || all.size() > most->size()) most = &all;
  }
  if (most == nullptr) return Eigen::Vector2f::Zero();
  std::vector<float> x;
  std::vector<float> y;
  for (const Eigen::Vector2f& d : *most) {
    x.push_back(d.x());
    y.push_back(d.y());
  }
  return {MedianOf(x), MedianOf(y)};
}

}  // namespace

std::vector<uint32_t> FindUnmovedKeypoints(const Keypoints& keypoints, const std::vector<uint32_t>& chosen,
                                           const Keypoints& others, const std::vector<bool>& usable,
                                           float max_shake_px, float max_distance_px) {
  const Eigen::Vector2f shift = CommonShift(keypoints, chosen, others, usable, max_shake_px);
  const Grid grid(others, usable, max_distance_px);
  std::vector<uint32_t> found;
  found.reserve(chosen.size());
  for (const uint32_t k : chosen) {
    float best = max_distance_px * max_distance_px;
    uint32_t nearest = kNoKeypoint;
    grid.ForEachNear(keypoints[k] + shift, [&](uint32_t other) {
      const float distance = (others[other] - keypoints[k] - shift).squaredNorm();
      if (distance > best || (distance == best && other >= nearest)) return;
      best = distance;
      nearest = other;
    });
    found.push_back(nearest);
  }
  return found;
}

}  // namespace s2gs
