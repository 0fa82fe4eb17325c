#include "sfm_split/base/parallel_for.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <stdexcept>
#include <string>
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

}  // namespace
}  // namespace s2gs
