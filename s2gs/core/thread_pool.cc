#include "s2gs/core/thread_pool.h"

#include <algorithm>
#include <chrono>

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

ThreadPool::ThreadPool(int num_threads) {
  workers_.reserve(std::max(0, num_threads - 1));
  for (int i = 1; i < num_threads; ++i) workers_.emplace_back([this] { Work(); });
}

ThreadPool::~ThreadPool() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    is_ending_ = true;
    ++num_loops_;
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
  if (workers_.empty() || count <= grain) {
    WorkOn(&loop);
  } else {
    bool must_wake = false;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      loop_ = &loop;
      ++num_loops_;
      must_wake = num_asleep_ > 0;
    }
    if (must_wake) wake_.notify_all();
    WorkOn(&loop);
    std::unique_lock<std::mutex> lock(mutex_);
    loop_ = nullptr;  // nobody joins any more
    if (num_working_ > 0) {
      lock.unlock();
      SpinUntil([this] { return num_working_ == 0; });
      lock.lock();
      finished_.wait(lock, [this] { return num_working_ == 0; });
    }
  }
  if (loop.exception) std::rethrow_exception(loop.exception);
}

void ThreadPool::WorkOn(Loop* loop) {
  for (;;) {
    const int64_t begin = loop->next.fetch_add(loop->grain);
    if (begin >= loop->count) return;
    try {
      (*loop->body)(begin, std::min(loop->count, begin + loop->grain));
    } catch (...) {
      const std::lock_guard<std::mutex> lock(loop->mutex);
      if (!loop->exception) loop->exception = std::current_exception();
      loop->next = loop->count;
      return;
    }
  }
}

void ThreadPool::Work() {
  uint64_t seen = 0;
  for (;;) {
    SpinUntil([&] { return num_loops_ != seen; });
    std::unique_lock<std::mutex> lock(mutex_);
    ++num_asleep_;
    wake_.wait(lock, [&] { return num_loops_ != seen; });
    --num_asleep_;
    if (is_ending_) return;
    seen = num_loops_;
    if (loop_ == nullptr) continue;  // over already
    Loop* const loop = loop_;
    ++num_working_;
    lock.unlock();
    WorkOn(loop);
    lock.lock();
    if (--num_working_ == 0) finished_.notify_one();
  }
}

}  // namespace s2gs
