#pragma once

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <exception>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

namespace s2gs {

/// Threads that share the iterations of loops. Unlike OpenMP's, a loop never waits for a thread that has not
/// begun to work on it, and idle threads sleep instead of spinning: both matter for loops of a few
/// milliseconds on a machine that does other work besides, where a spinning thread takes the core away from
/// the one that it waits for.
class ThreadPool {
 public:
  /// \param num_threads  with the caller's own; at least 1.
  explicit ThreadPool(int num_threads);
  ThreadPool(const ThreadPool&) = delete;
  ThreadPool& operator=(const ThreadPool&) = delete;
  ~ThreadPool();

  int num_threads() const { return static_cast<int>(workers_.size()) + 1; }

  /// Has no fewer threads from now on, with the caller's own. Not while they work.
  void Grow(int num_threads);

  /// Calls work(thread) by the caller, whose number is 0, and by other threads that are free meanwhile, each
  /// once at most and with a number of its own below `max_threads`; returns when all that have begun are
  /// done. One at a time. `work` must not throw.
  void Together(int max_threads, const std::function<void(int thread)>& work);

  /// Calls body(begin, end) for pieces of [0, count), of `grain` iterations each but for the last one, by any
  /// thread in any order, and returns when all are done. What a body throws first is thrown on; pieces that
  /// have not begun by then are left out. One loop at a time. Throws Interrupted, too: see StopWhen.
  void For(int64_t count, int64_t grain, const std::function<void(int64_t begin, int64_t end)>& body);
  /// The same with a few pieces for each thread.
  void For(int64_t count, const std::function<void(int64_t begin, int64_t end)>& body);

  /// While it lives, For asks before each piece whether to go on, and throws Interrupted once it is to stop:
  /// what takes long and consists of such loops hears a stop wherever it is.
  class StopWhen {
   public:
    /// \param stop_requested  outlives this; any thread may call it. Empty: nobody is asked.
    StopWhen(ThreadPool* threads, const std::function<bool()>& stop_requested);
    StopWhen(const StopWhen&) = delete;
    StopWhen& operator=(const StopWhen&) = delete;
    ~StopWhen() { threads_->stop_requested_ = before_; }

   private:
    ThreadPool* threads_;
    const std::function<bool()>* before_;
  };
  /// What For does before each piece, for work between loops. Throws Interrupted.
  void ThrowIfStopped() const;

 private:
  struct Loop {
    int64_t count = 0;
    int64_t grain = 1;
    const std::function<void(int64_t, int64_t)>* body = nullptr;
    std::atomic<int64_t> next{0};
    std::mutex mutex;
    std::exception_ptr exception;
  };

  void WorkOn(Loop* loop) const;
  void Work(int thread);

  std::mutex mutex_;
  std::condition_variable wake_;
  std::condition_variable finished_;
  const std::function<void(int)>* work_ = nullptr;  // that threads may join.
  int max_threads_ = 0;                             // that may.
  std::atomic<uint64_t> num_begun_{0};
  std::atomic<int> num_working_{0};  // threads that have joined.
  int num_asleep_ = 0;
  bool is_ending_ = false;
  const std::function<bool()>* stop_requested_ = nullptr;  // null: nobody is asked.
  std::vector<std::thread> workers_;
};

}  // namespace s2gs
