#pragma once

#include <algorithm>
#include <cstdint>

#include "sfm_split/base/error.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// ParallelFor over the rows of a picture that asks the reporter, from the calling thread, before every block
/// of rows: pictures may have 268 megapixels, and a lens takes about a microsecond a pixel. `work(y)` must
/// write nothing that another row reads. Throws Interrupted.
template <typename Work>
void ForEachRow(int height, int width, Reporter& reporter, const Work& work) {
  constexpr int64_t kPixelsInBlock = 1 << 20;
  const int64_t rows_in_block = std::max<int64_t>(1, kPixelsInBlock / std::max(width, 1));
  for (int64_t begin = 0; begin < height; begin += rows_in_block) {
    if (reporter.StopRequested()) throw Interrupted();
    const int64_t count = std::min<int64_t>(rows_in_block, height - begin);
    ParallelFor(count, 0, [&](int64_t of_block) { work(static_cast<int>(begin + of_block)); });
  }
}

}  // namespace s2gs
