#include "s2gs/cpu/view_buffers.h"

#include <gtest/gtest.h>

#include <functional>

#include "sfm_split/base/error.h"
#include "sfm_split/base/thread_pool.h"

namespace s2gs {
namespace {

// How often somebody is asked while room is made for a view, which is once a MiB that becomes zero.
int64_t LooksOf(ViewBuffers* buffers, int side, bool geometry, bool training) {
  ThreadPool threads(1);
  int64_t num_asked = 0;
  const std::function<bool()> never = [&] {
    ++num_asked;
    return false;
  };
  const ThreadPool::StopWhen stop(&threads, never);
  buffers->Prepare(side, side, geometry, true, training, &threads);
  return num_asked;
}

// A plane of 2048^2 floats is 16 MiB and a margin: pieces may be one more for each allocation.
TEST(ViewBuffers, WhatNobodyAskedForTakesNothing) {
  constexpr int kSide = 2048;
  constexpr int64_t kPlane = 16 + 1;
  ViewBuffers buffers;
  EXPECT_LE(LooksOf(&buffers, kSide, false, false), 5 * kPlane);
  EXPECT_EQ(LooksOf(&buffers, kSide, false, false), 0);
  EXPECT_LE(LooksOf(&buffers, kSide, true, false), 9 * kPlane);
  EXPECT_EQ(LooksOf(&buffers, kSide, false, false), 0);
  const int64_t of_training = LooksOf(&buffers, kSide, true, true);
  EXPECT_GE(of_training, 37 * 16);
  EXPECT_LE(of_training, 37 * kPlane);
  EXPECT_EQ(LooksOf(&buffers, kSide, true, true), 0);
}

int64_t NumNotZero(const float* plane, int64_t count) {
  int64_t num = 0;
  for (int64_t i = 0; i < count; ++i) num += plane[i] != 0 ? 1 : 0;
  return num;
}

// Room that was being made when somebody stopped holds what was there before.
TEST(ViewBuffers, AStopBeforeAllIsZeroIsMadeGood) {
  constexpr int kSide = 1024;
  ViewBuffers buffers;
  ThreadPool threads(1);
  buffers.Prepare(kSide, kSide, false, true, false, &threads);
  const int64_t count = static_cast<int64_t>(buffers.stride()) * kSide;
  float* foreground = buffers.planes().foreground;
  for (int64_t i = 0; i < count; ++i) foreground[i] = 1;
  int num_asked = 0;
  const std::function<bool()> at_the_third = [&] { return ++num_asked == 3; };
  {
    const ThreadPool::StopWhen stop(&threads, at_the_third);
    EXPECT_THROW(buffers.Prepare(kSide - 16, kSide, false, true, false, &threads), Interrupted);
    EXPECT_EQ(num_asked, 3);
  }
  buffers.Prepare(kSide - 16, kSide, false, true, false, &threads);
  EXPECT_EQ(NumNotZero(buffers.planes().foreground, static_cast<int64_t>(buffers.stride()) * kSide), 0);
  // What is there stays where nothing changes.
  buffers.planes().foreground[5] = 3;
  buffers.Prepare(kSide - 16, kSide, true, true, true, &threads);
  EXPECT_EQ(buffers.planes().foreground[5], 3);
  EXPECT_EQ(NumNotZero(buffers.planes().m2, static_cast<int64_t>(buffers.stride()) * kSide), 0);
  EXPECT_EQ(NumNotZero(buffers.gradients().distortion, static_cast<int64_t>(buffers.stride()) * kSide), 0);
}

}  // namespace
}  // namespace s2gs
