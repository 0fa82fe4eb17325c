#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "sfm_split/scene/features.h"

namespace s2gs {

/// One photo's keypoints sorted into square cells, to find those near a place. The keypoints must outlive it.
class KeypointGrid {
 public:
  /// \param cell_px  edge of a cell, of the size of the radii that will be asked for; larger where keypoints
  ///                 lie so far apart that there would be many more cells than keypoints [px].
  /// \param usable   per keypoint whether it can be found; empty: all can.
  KeypointGrid(const Keypoints& keypoints, float cell_px, const std::vector<bool>& usable = {});

  /// Calls visit(keypoint, squared distance) for all usable keypoints at most `radius` from `xy` [px].
  template <typename Visit>
  void ForEachWithin(const Eigen::Vector2f& xy, float radius, const Visit& visit) const {
    const Eigen::Vector2f low = (xy - corner_).array() - radius;
    const Eigen::Vector2f high = (xy - corner_).array() + radius;
    if (begin_.empty() || high.minCoeff() < 0) return;
    for (int row = Cell(low.y(), rows_); row <= Cell(high.y(), rows_); ++row) {
      for (int column = Cell(low.x(), columns_); column <= Cell(high.x(), columns_); ++column) {
        const size_t cell = static_cast<size_t>(row) * columns_ + column;
        for (uint32_t o = begin_[cell]; o < begin_[cell + 1]; ++o) {
          const float squared = (keypoints_[order_[o]] - xy).squaredNorm();
          if (squared <= radius * radius) visit(order_[o], squared);
        }
      }
    }
  }

 private:
  // The cell along one direction; places beyond the last keypoints count into the outermost cells.
  int Cell(float from_corner, int count) const {
    const float cell = from_corner / cell_px_;
    if (!(cell > 0)) return 0;
    return cell < static_cast<float>(count - 1) ? static_cast<int>(cell) : count - 1;
  }

  const Keypoints& keypoints_;
  float cell_px_;
  Eigen::Vector2f corner_ = Eigen::Vector2f::Zero();
  int columns_ = 0;
  int rows_ = 0;
  std::vector<uint32_t> begin_;  // per cell, into order_; empty without usable keypoints.
  std::vector<uint32_t> order_;
};

}  // namespace s2gs
