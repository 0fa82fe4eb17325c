#include "sfm_split/base/parallel_for.h"

#include <omp.h>

#include "sfm_split/base/thread_pool.h"

namespace s2gs {
namespace {

struct Place {
  int thread = 0;
  bool is_divided = false;  // the loop, among several threads
};

thread_local Place place;

class InLoop {
 public:
  explicit InLoop(Place inside) : before_(place) { place = inside; }
  InLoop(const InLoop&) = delete;
  InLoop& operator=(const InLoop&) = delete;
  ~InLoop() { place = before_; }

 private:
  Place before_;
};

// Of the process: threads are made when a loop first asks for them.
struct SharedPool {
  std::mutex mutex;  // held by the thread whose loop it works on
  ThreadPool threads{1};
};

SharedPool& Shared() {
  static SharedPool pool;
  return pool;
}

}  // namespace

int LoopThread() { return place.thread; }

int NumThreadsOf(int num_threads) { return num_threads > 0 ? num_threads : omp_get_max_threads(); }

void ForBlocks(int64_t count, int num_threads, const std::function<void(int64_t block)>& block) {
  const auto num_used = static_cast<int>(std::min<int64_t>(NumThreadsOf(num_threads), count));
  std::unique_lock<std::mutex> lock(Shared().mutex, std::defer_lock);
  if (num_used <= 1 || place.is_divided || !lock.try_lock()) {
    const InLoop inside({0, place.is_divided});
    for (int64_t i = 0; i < count; ++i) block(i);
    return;
  }
  ThreadPool& threads = Shared().threads;
  threads.Grow(num_used);
  std::atomic<int64_t> next = 0;
  threads.Together(num_used, [&](int thread) {
    const InLoop inside({thread, true});
    for (int64_t i = next++; i < count; i = next++) block(i);
  });
}

}  // namespace s2gs
