#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "sfm_split/base/parallel_for.h"

namespace s2gs {

/// Calls `prepare(i)` for all i below `count` on several threads, and `add(i, prepared)` in the order of i,
/// so that sums have the same bits however many threads there are.
template <typename Prepare, typename Add>
void PrepareAndAdd(size_t count, int num_threads, const Prepare& prepare, const Add& add) {
  constexpr size_t kAtOnce = 1024;  // that threads prepare before they are added
  std::vector<decltype(prepare(size_t{0}))> prepared;
  for (size_t begin = 0; begin < count; begin += kAtOnce) {
    const size_t here = std::min(kAtOnce, count - begin);
    prepared.clear();
    prepared.resize(here);
    ParallelFor(static_cast<int64_t>(here), num_threads, [&](int64_t i) {
      prepared[static_cast<size_t>(i)] = prepare(begin + static_cast<size_t>(i));
    });
    for (size_t i = 0; i < here; ++i) add(begin + i, &prepared[i]);
  }
}

}  // namespace s2gs
