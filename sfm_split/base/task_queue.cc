#include "sfm_split/base/task_queue.h"

#include <utility>

#include "sfm_split/base/error.h"

namespace s2gs {

TaskQueue::TaskQueue(int num_threads) {
  S2GS_INVARIANT(num_threads >= 1);
  threads_.reserve(static_cast<size_t>(num_threads));
  for (int i = 0; i < num_threads; ++i) threads_.emplace_back([this] { Work(); });
}

TaskQueue::~TaskQueue() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    waiting_.clear();
    is_ending_ = true;
  }
  wake_.notify_all();
  for (std::thread& thread : threads_) thread.join();
}

void TaskQueue::Add(std::function<void()> task) {
  std::unique_lock<std::mutex> lock(mutex_);
  taken_.wait(lock, [&] { return waiting_.size() < threads_.size() || exception_ != nullptr; });
  RethrowLocked();
  waiting_.push_back(std::move(task));
  wake_.notify_one();
}

void TaskQueue::Finish() {
  std::unique_lock<std::mutex> lock(mutex_);
  taken_.wait(lock, [&] { return waiting_.empty() && num_working_ == 0; });
  RethrowLocked();
}

void TaskQueue::RethrowLocked() {
  if (exception_ != nullptr) std::rethrow_exception(std::exchange(exception_, nullptr));
}

void TaskQueue::Work() {
  std::unique_lock<std::mutex> lock(mutex_);
  while (true) {
    wake_.wait(lock, [&] { return is_ending_ || !waiting_.empty(); });
    if (waiting_.empty()) return;
    std::function<void()> task = std::move(waiting_.front());
    waiting_.pop_front();
    ++num_working_;
    lock.unlock();
    taken_.notify_all();
    std::exception_ptr thrown;
    try {
      task();
    } catch (...) {
      thrown = std::current_exception();
    }
    task = nullptr;  // what it holds goes before it counts as done
    lock.lock();
    --num_working_;
    if (thrown != nullptr) {
      if (exception_ == nullptr) exception_ = thrown;
      waiting_.clear();
    }
    taken_.notify_all();
  }
}

}  // namespace s2gs
