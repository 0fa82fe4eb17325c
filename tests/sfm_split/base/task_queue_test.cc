#include "sfm_split/base/task_queue.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <memory>
#include <stdexcept>
#include <thread>
#include <vector>

namespace s2gs {
namespace {

TEST(TaskQueue, DoesEachTaskOnce) {
  for (const int num_threads : {1, 3}) {
    TaskQueue queue(num_threads);
    std::vector<std::atomic<int>> done(100);
    for (std::atomic<int>& one : done) queue.Add([&one] { ++one; });
    queue.Finish();
    for (const std::atomic<int>& one : done) EXPECT_EQ(one, 1);
    queue.Add([&done] { ++done[0]; });  // and goes on
    queue.Finish();
    EXPECT_EQ(done[0], 2);
  }
}

// What tasks hold must not pile up when they are slower than the caller.
TEST(TaskQueue, HoldsFewTasks) {
  constexpr int kThreads = 2;
  std::atomic<int> alive{0};
  int most = 0;
  struct Load {
    explicit Load(std::atomic<int>* count) : count(count) { ++*count; }
    Load(const Load& other) : count(other.count) { ++*count; }
    ~Load() { --*count; }
    Load& operator=(const Load&) = delete;
    std::atomic<int>* count;
  };
  {
    TaskQueue queue(kThreads);
    for (int i = 0; i < 200; ++i) {
      const auto load = std::make_shared<Load>(&alive);
      queue.Add([load] { std::this_thread::yield(); });
      most = std::max(most, alive.load());
    }
    queue.Finish();
    EXPECT_EQ(alive, 0);
  }
  EXPECT_LE(most, 2 * kThreads + 1);  // waiting, at work, and the caller's own.
}

TEST(TaskQueue, ThrowsWhatATaskThrows) {
  TaskQueue queue(2);
  queue.Add([] { throw std::runtime_error("disk full"); });
  EXPECT_THROW(queue.Finish(), std::runtime_error);
  queue.Finish();  // once
  int caught = 0;
  for (int i = 0; i < 1000 && caught == 0; ++i) {
    try {
      queue.Add([] { throw std::runtime_error("disk full"); });
    } catch (const std::runtime_error&) {
      ++caught;
    }
  }
  EXPECT_EQ(caught, 1) << "Add went on for ever";
}

TEST(TaskQueue, LeavesOutWhatHasNotBegunWhenItGoes) {
  std::atomic<int> begun{0};
  {
    TaskQueue queue(1);
    queue.Add([&begun] { ++begun; });
    queue.Finish();
  }
  EXPECT_EQ(begun, 1);
}

}  // namespace
}  // namespace s2gs
