#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace s2gs {

/// Which photo an iteration sees: all in a random order, then all in another one. It follows from the seed
/// and the iteration alone.
class PhotoOrder {
 public:
  /// \param count  of photos, above 0.
  PhotoOrder(size_t count, uint64_t seed);

  /// How often all photos were seen before this iteration. \param iteration  from 1.
  int64_t RoundOf(int64_t iteration) const;
  /// Index of its photo.
  int At(int64_t iteration);

 private:
  void Shuffle(int64_t round);

  std::vector<int> order_;
  uint64_t seed_;
  int64_t round_ = -1;  // that order_ is of
};

}  // namespace s2gs
