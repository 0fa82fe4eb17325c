#include "sfm_split/base/thread_pool.h"

#include <algorithm>
#include <chrono>

#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

// About what falling asleep and waking up costs: loops that follow each other closely find the threads awake.
constexpr std::chrono::microseconds kStayAwake(50);
constexpr int kPiecesPerThread = 8;

void Pause() {
#if defined(__x86_64__)
  __builtin_ia32_pause();
#endif
}

// Waits a little. Returns whether it is so.
template <typename Condition>
bool SpinUntil(const Condition& is_so) {
  const auto end = std::chrono::steady_clock::now() + kStayAwake;
  do {
    for (int i = 0; i < 32; ++i) {
      if (is_so()) return true;
      Pause();
    }
  } while (std::chrono::steady_clock::now() < end);
  return is_so();
}

}  // namespace

ThreadPool::ThreadPool(int num_threads) { Grow(num_threads); }

ThreadPool::~ThreadPool() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    is_ending_ = true;
    ++num_begun_;
  }
  wake_.notify_all();
  for (std::thread& worker : workers_) worker.join();
}

void ThreadPool::For(int64_t count, const std::function<void(int64_t, int64_t)>& body) {
  const int64_t pieces = workers_.empty() ? 1 : int64_t{kPiecesPerThread} * num_threads();
  For(count, std::max<int64_t>(1, (count + pieces - 1) / pieces), body);
}

void ThreadPool::For(int64_t count, int64_t grain, const std::function<void(int64_t, int64_t)>& body) {
  Loop loop;
  loop.count = count;
  loop.grain = grain;
  loop.body = &body;
  if (count <= grain) {
    WorkOn(&loop);
  } else {
    Together(num_threads(), [&](int) { WorkOn(&loop); });
  }
  if (loop.exception) std::rethrow_exception(loop.exception);
}

void ThreadPool::Grow(int num_threads) {
  for (int thread = this->num_threads(); thread < num_threads; ++thread)
    workers_.emplace_back([this, thread] { Work(thread); });
}

void ThreadPool::Together(int max_threads, const std::function<void(int)>& work) {
  if (workers_.empty() || max_threads <= 1) {
    work(0);
    return;
  }
  bool must_wake = false;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    work_ = &work;
    max_threads_ = max_threads;
    ++num_begun_;
    must_wake = num_asleep_ > 0;
  }
  if (must_wake) wake_.notify_all();
  work(0);
  std::unique_lock<std::mutex> lock(mutex_);
  work_ = nullptr;  // nobody joins any more
  if (num_working_ == 0) return;
  lock.unlock();
  SpinUntil([this] { return num_working_ == 0; });
  lock.lock();
  finished_.wait(lock, [this] { return num_working_ == 0; });
}

ThreadPool::StopWhen::StopWhen(ThreadPool* threads, const std::function<bool()>& stop_requested)
    : threads_(threads), before_(threads->stop_requested_) {
  threads_->stop_requested_ = stop_requested ? &stop_requested : nullptr;
}

void ThreadPool::ThrowIfStopped() const {
  if (stop_requested_ != nullptr && (*stop_requested_)()) throw Interrupted();
}

void ThreadPool::WorkOn(Loop* loop) const {
  for (;;) {
    const int64_t begin = loop->next.fetch_add(loop->grain);
    if (begin >= loop->count) return;
    try {
      ThrowIfStopped();
      (*loop->body)(begin, std::min(loop->count, begin + loop->grain));
    } catch (...) {
      const std::lock_guard<std::mutex> lock(loop->mutex);
      if (!loop->exception) loop->exception = std::current_exception();
      loop->next = loop->count;
      return;
    }
  }
}

void ThreadPool::Work(int thread) {
  uint64_t seen = 0;
  for (;;) {
    SpinUntil([&] { return num_begun_ != seen; });
    std::unique_lock<std::mutex> lock(mutex_);
    ++num_asleep_;
    wake_.wait(lock, [&] { return num_begun_ != seen; });
    --num_asleep_;
    if (is_ending_) return;
    seen = num_begun_;
    if (work_ == nullptr || thread >= max_threads_) continue;  // over already, or not asked
    const std::function<void(int)>& work = *work_;
    ++num_working_;
    lock.unlock();
    work(thread);
    lock.lock();
    if (--num_working_ == 0) finished_.notify_one();
  }
}

}  // namespace s2gs
