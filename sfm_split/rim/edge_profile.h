#pragma once

#include <vector>

#include "sfm_split/rim/edge_picture.h"
#include "sfm_split/rim/searched_circles.h"

namespace s2gs {

/// The slope across a line through a place, each step the mean of three lines beside each other.
class EdgeProfile {
 public:
  static constexpr double kStepPx = 0.25;  ///< a quarter of what pixels tell apart.

  /// \param reach_px  on either side.
  EdgeProfile(const EdgePicture& picture, const SearchedCircles::Crossing& at, double reach_px);

  /// False where it leaves the picture.
  bool IsSeen() const { return !slopes_.empty(); }
  struct Edge {
    double at_px = 0;  ///< outwards.
    double slope = 0;  ///< grey values over two pixels.
  };
  /// Where slopes are steeper than beside.
  std::vector<Edge> Edges() const;
  /// At each step, from the innermost on.
  const std::vector<float>& slopes() const { return slopes_; }

 private:
  std::vector<float> slopes_;
  int reach_ = 0;  // [steps]
};

}  // namespace s2gs
