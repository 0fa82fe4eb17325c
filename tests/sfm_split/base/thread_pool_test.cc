#include "sfm_split/base/thread_pool.h"

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <functional>
#include <stdexcept>
#include <string>
#include <vector>

#include "sfm_split/base/error.h"

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

// One thread asks before each piece; what comes after the answer is left out, and the next loop is whole
// again.
TEST(ThreadPool, AStopLeavesTheOtherPiecesUndone) {
  ThreadPool threads(1);
  int64_t num_asked = 0;
  const std::function<bool()> at_the_fourth = [&] { return ++num_asked == 4; };
  std::vector<int64_t> done;
  const auto note = [&](int64_t begin, int64_t) { done.push_back(begin); };
  {
    const ThreadPool::StopWhen stop(&threads, at_the_fourth);
    EXPECT_THROW(threads.For(100, 10, note), Interrupted);
    EXPECT_EQ(done, (std::vector<int64_t>{0, 10, 20}));
    const std::function<bool()> nobody;
    const ThreadPool::StopWhen never(&threads, nobody);
    threads.For(100, 10, note);
    EXPECT_EQ(num_asked, 4);
  }
  threads.For(100, 10, note);
  EXPECT_EQ(done.size(), 23U);
  EXPECT_EQ(num_asked, 4);
}

TEST(ThreadPool, SeveralThreadsHearAStop) {
  ThreadPool threads(4);
  std::atomic<bool> is_stopped = false;
  const std::function<bool()> asked = [&] { return is_stopped.load(); };
  const ThreadPool::StopWhen stop(&threads, asked);
  std::atomic<int64_t> num_done = 0;
  EXPECT_THROW(threads.For(1'000'000, 1,
                           [&](int64_t, int64_t) {
                             is_stopped = true;
                             ++num_done;
                           }),
               Interrupted);
  EXPECT_LE(num_done, 4);  // each thread may have asked before the first was done
}

}  // namespace
}  // namespace s2gs
