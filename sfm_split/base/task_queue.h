#pragma once

#include <condition_variable>
#include <cstddef>
#include <deque>
#include <exception>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

namespace s2gs {

/// Threads that do tasks while the caller prepares more: files are compressed and written while the next
/// picture is drawn.
class TaskQueue {
 public:
  /// \param num_threads  at least 1.
  explicit TaskQueue(int num_threads);
  TaskQueue(const TaskQueue&) = delete;
  TaskQueue& operator=(const TaskQueue&) = delete;
  /// Leaves out what has not begun, and waits for the rest.
  ~TaskQueue();

  /// Leaves a task to the threads, in any order. Waits while there is one that has not begun for each thread,
  /// so that memory stays bounded. Throws what a task has thrown; tasks that have not begun are then left
  /// out.
  void Add(std::function<void()> task);
  /// Returns when all tasks are done; throws what one of them has thrown first.
  void Finish();

 private:
  void Work();
  void RethrowLocked();

  std::mutex mutex_;
  std::condition_variable wake_;   // of the threads.
  std::condition_variable taken_;  // of the caller.
  std::deque<std::function<void()>> waiting_;
  size_t num_working_ = 0;
  bool is_ending_ = false;
  std::exception_ptr exception_;
  std::vector<std::thread> threads_;
};

}  // namespace s2gs
