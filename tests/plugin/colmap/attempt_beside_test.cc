#include "plugin/colmap/attempt_beside.h"

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

constexpr int kFew = 2;
constexpr int kMany = 16;

void WaitUntilStopped(Reporter& reporter) {
  while (!reporter.StopRequested()) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  throw Interrupted();
}

class HearingReporter : public Reporter {
 public:
  void Log(LogLevel /*level*/, std::string_view message) override { heard.emplace_back(message); }
  std::vector<std::string> heard;
};

class StoppedReporter : public Reporter {
 public:
  bool StopRequested() const override { return true; }
};

// What is left of the work, by the caller's thread alone.
struct Work {
  bool has_run = false;
  bool has_ended = false;
  bool is_undone = false;
  NeedlessWork Until(const std::function<void(Reporter&)>& work) {
    return {[this, work](Reporter& reporter) {
              has_run = true;
              work(reporter);
              has_ended = true;
            },
            [this] { is_undone = true; }};
  }
};

TEST(AttemptBeside, WorkIsStoppedOnceTheAttemptHasSucceeded) {
  Work work;
  Reporter reporter;
  EXPECT_TRUE(AttemptBeside([](Reporter&) { return true; }, work.Until(WaitUntilStopped), kMany, reporter));
  EXPECT_TRUE(work.has_run);
  EXPECT_FALSE(work.has_ended);
  EXPECT_TRUE(work.is_undone);
}

TEST(AttemptBeside, WorkThatEndedFirstIsUndoneAllTheSame) {
  Work work;
  Reporter reporter;
  std::atomic<bool> may_end = false;
  const auto attempt = [&](Reporter&) {
    while (!may_end) std::this_thread::sleep_for(std::chrono::milliseconds(1));
    return true;
  };
  EXPECT_TRUE(AttemptBeside(attempt, work.Until([&](Reporter&) { may_end = true; }), kMany, reporter));
  EXPECT_TRUE(work.has_ended);
  EXPECT_TRUE(work.is_undone);
}

TEST(AttemptBeside, WorkIsDoneWhereTheAttemptFails) {
  for (const int num_threads : {kFew, kMany}) {
    Work work;
    Reporter reporter;
    EXPECT_FALSE(
        AttemptBeside([](Reporter&) { return false; }, work.Until([](Reporter&) {}), num_threads, reporter));
    EXPECT_TRUE(work.has_ended);
    EXPECT_FALSE(work.is_undone);
  }
}

TEST(AttemptBeside, OnFewCoresTheWorkWaitsForTheAttempt) {
  Work work;
  Reporter reporter;
  const auto attempt = [&](Reporter&) {
    EXPECT_FALSE(work.has_run);
    return true;
  };
  EXPECT_TRUE(AttemptBeside(attempt, work.Until([](Reporter&) {}), kFew, reporter));
  EXPECT_FALSE(work.has_run);
  EXPECT_TRUE(work.is_undone);  // what an earlier run left
}

TEST(AttemptBeside, FaultsOfTheWorkCountWhereItIsNeeded) {
  const auto fails = [](Reporter&) { throw UserError("a.db", "is damaged", "Mend it"); };
  Reporter reporter;
  Work needless;
  EXPECT_TRUE(AttemptBeside([](Reporter&) { return true; }, needless.Until(fails), kMany, reporter));
  EXPECT_TRUE(needless.is_undone);
  for (const int num_threads : {kFew, kMany}) {
    Work needed;
    EXPECT_THROW(AttemptBeside([](Reporter&) { return false; }, needed.Until(fails), num_threads, reporter),
                 UserError);
    EXPECT_FALSE(needed.is_undone);
  }
}

TEST(AttemptBeside, FaultsOfTheAttemptAlwaysCount) {
  const auto fails = [](Reporter&) -> bool { throw UserError("a.jpg", "is damaged", "Mend it"); };
  Reporter reporter;
  for (const int num_threads : {kFew, kMany}) {
    Work work;
    EXPECT_THROW(AttemptBeside(fails, work.Until([](Reporter&) {}), num_threads, reporter), UserError);
    EXPECT_FALSE(work.is_undone);
  }
}

TEST(AttemptBeside, BothStopWhenTheUserAsks) {
  const auto attempt = [](Reporter& reporter) -> bool {
    WaitUntilStopped(reporter);
    return true;
  };
  StoppedReporter reporter;
  Work work;
  EXPECT_THROW(AttemptBeside(attempt, work.Until(WaitUntilStopped), kMany, reporter), Interrupted);
  EXPECT_FALSE(work.is_undone);
}

TEST(AttemptBeside, WhatTheAttemptSaysIsHeardByTheCallersThread) {
  for (const int num_threads : {kFew, kMany}) {
    Work work;
    HearingReporter reporter;
    const auto attempt = [](Reporter& to) {
      to.Info("one");
      to.Info("two");
      return false;
    };
    AttemptBeside(attempt, work.Until([](Reporter&) {}), num_threads, reporter);
    EXPECT_EQ(reporter.heard, (std::vector<std::string>{"one", "two"}));
  }
}

}  // namespace
}  // namespace s2gs
