#include "sfm_split/base/parallel_for.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

namespace s2gs {
namespace {

TEST(ParallelFor, DoesEveryIndexOnceForAnyGrainAndNumberOfThreads) {
  for (const int num_threads : {0, 1, 3}) {
    for (const int64_t grain : {1, 2, 7, 1000}) {
      for (const int64_t count : {0, 1, 2, 13, 14, 15}) {
        std::vector<int> done(count, 0);
        ParallelFor(count, num_threads, grain, [&](int64_t i) { ++done[i]; });
        EXPECT_EQ(done, std::vector<int>(count, 1)) << count << " by " << grain;
      }
    }
  }
}

TEST(ParallelFor, ThrowsWhatTheFirstIndexThrew) {
  for (const int64_t grain : {1, 4, 64}) {
    for (int run = 0; run < 20; ++run) {
      try {
        ParallelFor(40, 3, grain, [](int64_t i) {
          if (i % 10 == 7) throw std::runtime_error(std::to_string(i));
        });
        ADD_FAILURE() << "nothing was thrown";
      } catch (const std::runtime_error& error) {
        EXPECT_STREQ(error.what(), "7");
      }
    }
  }
}

TEST(ParallelFor, ThreadsOfALoopHaveNumbersOfTheirOwn) {
  EXPECT_EQ(LoopThread(), 0);
  const int num_threads = 4;
  std::vector<std::atomic<int>> inside(num_threads);
  std::atomic<int> met{0};
  const auto until = std::chrono::steady_clock::now() + std::chrono::seconds(20);
  ParallelFor(num_threads, num_threads, [&](int64_t) {
    const int thread = LoopThread();
    ASSERT_GE(thread, 0);
    ASSERT_LT(thread, num_threads);
    EXPECT_EQ(++inside[thread], 1);
    // All together, or never.
    ++met;
    while (met < num_threads && std::chrono::steady_clock::now() < until) std::this_thread::yield();
    --inside[thread];
  });
  EXPECT_EQ(met, num_threads);
  EXPECT_EQ(LoopThread(), 0);
}

TEST(ParallelFor, TakesNoMoreThreadsThanItIsTold) {
  ParallelFor(100, 8, [](int64_t) {});
  ParallelFor(1000, 2, [](int64_t) { EXPECT_LT(LoopThread(), 2); });
}

// What a thread has of its own is counted by the inner loop's threads there, of which there is one.
TEST(ParallelFor, ALoopInsideAnotherIsDoneByItsCallerAlone) {
  std::vector<int> done(12 * 30, 0);
  ParallelFor(12, 3, [&](int64_t i) {
    const int outer = LoopThread();
    const std::thread::id caller = std::this_thread::get_id();
    ParallelFor(30, 4, [&](int64_t k) {
      EXPECT_EQ(LoopThread(), 0);
      EXPECT_EQ(std::this_thread::get_id(), caller);
      ++done[30 * i + k];
    });
    EXPECT_EQ(LoopThread(), outer);
  });
  EXPECT_EQ(done, std::vector<int>(done.size(), 1));
}

TEST(ParallelFor, LoopsOfSeveralThreadsAtOnceAreAllDone) {
  constexpr int kCallers = 4;
  std::vector<std::vector<int>> done(kCallers, std::vector<int>(500, 0));
  std::vector<std::thread> callers;
  callers.reserve(kCallers);
  for (int caller = 0; caller < kCallers; ++caller) {
    callers.emplace_back([&own = done[caller]] {
      for (int round = 0; round < 200; ++round)
        ParallelFor(static_cast<int64_t>(own.size()), 3, 7, [&](int64_t i) { ++own[i]; });
    });
  }
  for (std::thread& caller : callers) caller.join();
  for (const std::vector<int>& own : done) EXPECT_EQ(own, std::vector<int>(own.size(), 200));
}

}  // namespace
}  // namespace s2gs
