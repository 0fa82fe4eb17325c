#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <exception>
#include <functional>
#include <limits>
#include <mutex>

namespace s2gs {

/// The number of the thread in the loop that it works in, below the loop's number of threads; 0: the one that
/// called the loop, or no loop.
int LoopThread();

/// How many threads a loop of `num_threads` takes: these, or for 0 as many as OpenMP takes by itself.
int NumThreadsOf(int num_threads);

/// Calls `block(i)` for all i below `count` from several threads, each taking the next i that is left.
/// Threads that wait for work sleep, unlike OpenMP's, which spin for milliseconds and take the cores from
/// those that have work. A loop inside another's, and one that is called while another thread runs one, is
/// done by its caller alone. `block` must not throw. \param num_threads  as of NumThreadsOf().
void ForBlocks(int64_t count, int num_threads, const std::function<void(int64_t block)>& block);

/// Calls `work(i)` for all i below `count` from several threads, each taking `grain` of them in a row: more
/// than 1 where one call is short. When calls throw, the exception of the smallest i among them is thrown
/// again once all threads are done; later calls may be left out.
/// \param num_threads  as of NumThreadsOf().
template <typename Work>
void ParallelFor(int64_t count, int num_threads, int64_t grain, const Work& work) {
  std::mutex mutex;
  std::exception_ptr error;
  std::atomic<int64_t> error_index = std::numeric_limits<int64_t>::max();
  ForBlocks((count + grain - 1) / grain, num_threads, [&](int64_t block) {
    const int64_t end = std::min(count, (block + 1) * grain);
    int64_t i = block * grain;
    if (i > error_index) return;
    try {
      for (; i < end; ++i) work(i);
    } catch (...) {
      const std::lock_guard<std::mutex> lock(mutex);
      if (i < error_index) {
        error = std::current_exception();
        error_index = i;
      }
    }
  });
  if (error) std::rethrow_exception(error);
}

template <typename Work>
void ParallelFor(int64_t count, int num_threads, const Work& work) {
  ParallelFor(count, num_threads, 1, work);
}

}  // namespace s2gs
