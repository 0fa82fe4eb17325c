#pragma once

#include <omp.h>

#include <algorithm>
#include <cstdint>
#include <exception>
#include <limits>

namespace s2gs {

/// Calls `work(i)` for all i below `count` from several threads, each taking `grain` of them in a row: more
/// than 1 where one call is short. When calls throw, the exception of the smallest i among them is thrown
/// again once all threads are done; later calls may be left out. (An exception that leaves a bare OpenMP
/// region ends the program.)
/// \param num_threads  0: as many as OpenMP takes by itself.
template <typename Work>
void ParallelFor(int64_t count, int num_threads, int64_t grain, const Work& work) {
  std::exception_ptr error;
  int64_t error_index = std::numeric_limits<int64_t>::max();
  const int64_t num_blocks = (count + grain - 1) / grain;
  const int num_used = num_threads > 0 ? num_threads : omp_get_max_threads();
#pragma omp parallel for schedule(dynamic) num_threads(num_used)
  for (int64_t block = 0; block < num_blocks; ++block) {
    int64_t first_error = 0;
#pragma omp atomic read
    first_error = error_index;
    const int64_t end = std::min(count, (block + 1) * grain);
    int64_t i = block * grain;
    if (i > first_error) continue;
    try {
      for (; i < end; ++i) work(i);
    } catch (...) {
#pragma omp critical(s2gs_parallel_for)
      if (i < error_index) {
        error = std::current_exception();
#pragma omp atomic write
        error_index = i;
      }
    }
  }
  if (error) std::rethrow_exception(error);
}

template <typename Work>
void ParallelFor(int64_t count, int num_threads, const Work& work) {
  ParallelFor(count, num_threads, 1, work);
}

}  // namespace s2gs
