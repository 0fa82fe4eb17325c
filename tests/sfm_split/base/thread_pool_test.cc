#include "sfm_split/base/thread_pool.h"

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <stdexcept>
#include <string>
#include <vector>

namespace s2gs {
namespace {

TEST(ThreadPool, DoesEveryIterationOnce) {
  for (const int num_threads : {1, 2, 7}) {
    ThreadPool threads(num_threads);
    EXPECT_EQ(threads.num_threads(), num_threads);
    for (const int64_t count : {0, 1, 2, 63, 64, 1000}) {
      for (const int64_t grain : {1, 3, 64, 5000}) {
        std::vector<int> times(count, 0);
        threads.For(count, grain, [&](int64_t begin, int64_t end) {
          EXPECT_EQ(begin % grain, 0);
          EXPECT_LE(end - begin, grain);
          for (int64_t i = begin; i < end; ++i) ++times[i];
        });
        EXPECT_EQ(times, std::vector<int>(count, 1)) << num_threads << " " << count << " " << grain;
      }
      std::vector<int> times(count, 0);
      threads.For(count, [&](int64_t begin, int64_t end) {
        for (int64_t i = begin; i < end; ++i) ++times[i];
      });
      EXPECT_EQ(times, std::vector<int>(count, 1));
    }
  }
}

TEST(ThreadPool, LoopsOfAllLengthsInARowSeeWhatTheOnesBeforeWrote) {
  ThreadPool threads(4);
  std::vector<int64_t> values(997, 0);
  for (int round = 0; round < 3000; ++round) {
    // Some rounds are so far apart that the threads fall asleep.
    if (round % 500 == 499) std::this_thread::sleep_for(std::chrono::milliseconds(2));
    threads.For(static_cast<int64_t>(values.size()), 1 + round % 50, [&](int64_t begin, int64_t end) {
      for (int64_t i = begin; i < end; ++i) {
        EXPECT_EQ(values[i], round);
        values[i] = round + 1;
      }
    });
  }
}

TEST(ThreadPool, ThreadsDoTakePart) {
  ThreadPool threads(3);
  std::atomic<int> inside{0};
  std::atomic<int> most{0};
  const auto until = std::chrono::steady_clock::now() + std::chrono::seconds(20);
  threads.For(3, 1, [&](int64_t, int64_t) {
    ++inside;
    // Together, or never.
    while (inside < 3 && std::chrono::steady_clock::now() < until) std::this_thread::yield();
    most = std::max<int>(most, inside);
  });
  EXPECT_EQ(most, 3);
}

TEST(ThreadPool, ThrowsOnWhatABodyThrew) {
  ThreadPool threads(3);
  for (int round = 0; round < 20; ++round) {
    try {
      threads.For(1000, 1, [&](int64_t begin, int64_t) {
        if (begin == 5 * round) throw std::runtime_error("at " + std::to_string(begin));
      });
      FAIL() << "nothing was thrown";
    } catch (const std::runtime_error& error) {
      EXPECT_EQ(error.what(), "at " + std::to_string(5 * round));
    }
    std::atomic<int> count{0};
    threads.For(100, 1, [&](int64_t, int64_t) { ++count; });
    EXPECT_EQ(count, 100);
  }
}

TEST(ThreadPool, WorksTogetherByThreadsOfNumbersBelowTheBound) {
  ThreadPool threads(2);
  threads.Grow(5);
  EXPECT_EQ(threads.num_threads(), 5);
  threads.Grow(3);
  EXPECT_EQ(threads.num_threads(), 5);
  for (int round = 0; round < 500; ++round) {
    const int bound = 1 + round % 5;
    std::vector<std::atomic<int>> times(5);
    threads.Together(bound, [&](int thread) { ++times[thread]; });
    EXPECT_EQ(times[0], 1);
    for (int thread = 1; thread < 5; ++thread) EXPECT_LE(times[thread], thread < bound ? 1 : 0);
  }
}

}  // namespace
}  // namespace s2gs
