#include "sfm_split/matching/keypoint_grid.h"

#include <Eigen/Geometry>
#include <cmath>

namespace s2gs {
namespace {

constexpr float kMaxCellsPerKeypoint = 64;  // memory: 256 bytes a keypoint; larger cells only take longer

}  // namespace

KeypointGrid::KeypointGrid(const Keypoints& keypoints, float cell_px, const std::vector<bool>& usable)
    : keypoints_(keypoints), cell_px_(cell_px) {
  std::vector<uint32_t> used;
  used.reserve(keypoints.size());
  Eigen::AlignedBox<float, 2> box;
  for (uint32_t k = 0; k < keypoints.size(); ++k) {
    if (!usable.empty() && !usable[k]) continue;
    used.push_back(k);
    box.extend(keypoints[k]);
  }
  if (used.empty()) return;
  corner_ = box.min();
  const Eigen::Vector2f extent = box.sizes();
  const float max_cells = kMaxCellsPerKeypoint * static_cast<float>(used.size());
  while ((extent.x() / cell_px_ + 1) * (extent.y() / cell_px_ + 1) > max_cells) cell_px_ *= 2;
  columns_ = static_cast<int>(extent.x() / cell_px_) + 1;
  rows_ = static_cast<int>(extent.y() / cell_px_) + 1;

  begin_.assign(static_cast<size_t>(columns_) * rows_ + 1, 0);
  std::vector<uint32_t> cell(used.size());
  for (size_t u = 0; u < used.size(); ++u) {
    const Eigen::Vector2f from_corner = keypoints[used[u]] - corner_;
    const auto row = static_cast<uint32_t>(Cell(from_corner.y(), rows_));
    cell[u] = row * static_cast<uint32_t>(columns_) + static_cast<uint32_t>(Cell(from_corner.x(), columns_));
    ++begin_[cell[u] + 1];
  }
  for (size_t c = 1; c < begin_.size(); ++c) begin_[c] += begin_[c - 1];
  order_.resize(used.size());
  std::vector<uint32_t> next(begin_.begin(), begin_.end() - 1);
  for (size_t u = 0; u < used.size(); ++u) order_[next[cell[u]]++] = used[u];
}

}  // namespace s2gs
