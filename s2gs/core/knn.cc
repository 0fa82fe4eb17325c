#include "s2gs/core/knn.h"

#include <algorithm>
#include <flann/flann.hpp>

namespace s2gs {

Neighbours FindNeighbours(const std::vector<float>& points, int k, int num_threads) {
  const size_t count = points.size() / 3;
  Neighbours result;
  if (count < 2 || k < 1) return result;
  result.k = static_cast<int>(std::min<size_t>(k, count - 1));
  const auto num_found = static_cast<size_t>(result.k) + 1;

  // FLANN takes its points as non-const but does not change them.
  const flann::Matrix<float> data(const_cast<float*>(points.data()), count, 3);
  flann::Index<flann::L2_3D<float>> tree(data, flann::KDTreeSingleIndexParams(16, false));
  tree.buildIndex();
  std::vector<int> found(count * num_found);
  std::vector<float> distances(count * num_found);
  flann::Matrix<int> found_rows(found.data(), count, num_found);
  flann::Matrix<float> distance_rows(distances.data(), count, num_found);
  flann::SearchParams search(flann::FLANN_CHECKS_UNLIMITED);
  search.cores = num_threads;
  tree.knnSearch(data, found_rows, distance_rows, num_found, search);

  const auto kept = static_cast<size_t>(result.k);
  result.index.resize(count * kept);
  result.distance_sq.resize(count * kept);
  for (size_t i = 0; i < count; ++i) {
    size_t out = 0;
    for (size_t j = 0; j < num_found && out < kept; ++j) {
      const int other = found[i * num_found + j];
      // Among duplicates the point itself may come late or not at all; then the farthest is left out.
      if (other < 0 || static_cast<size_t>(other) == i) continue;
      result.index[i * kept + out] = static_cast<uint32_t>(other);
      result.distance_sq[i * kept + out] = distances[i * num_found + j];
      ++out;
    }
  }
  return result;
}

}  // namespace s2gs
