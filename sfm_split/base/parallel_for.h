#pragma once

#include <omp.h>

#include <cstdint>
#include <exception>
#include <limits>

namespace s2gs {

/// Calls `work(i)` for all i below `count` from several threads. When calls throw, the exception of the
/// smallest i among them is thrown again once all threads are done; later calls may be left out.
template <typename Work>
void ParallelFor(int64_t count, int num_threads, const Work& work) {
  std::exception_ptr error;
  int64_t error_index = std::numeric_limits<int64_t>::max();
#pragma omp parallel for schedule(dynamic) num_threads(num_threads)
  for (int64_t i = 0; i < count; ++i) {
    int64_t first_error = 0;
#pragma omp atomic read
    first_error = error_index;
    if (i > first_error) continue;
    try {
      work(i);
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

}  // namespace s2gs
