#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

namespace s2gs {

/// The k nearest other points of each point, nearest first.
struct Neighbours {
  int k = 0;                       ///< fewer than asked for where there are not enough points.
  std::vector<uint32_t> index;     ///< k per point.
  std::vector<float> distance_sq;  ///< k per point, in squared units of the points.
};

/// Exact, by FLANN's single k-d tree. A point is never its own neighbour, but a duplicate of it may be.
/// \param points  3 finite coordinates per point.
/// The result does not depend on the number of threads.
Neighbours FindNeighbours(const std::vector<float>& points, int k, int num_threads = 0);

}  // namespace s2gs
