#include "s2gs/held_out_course.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace s2gs {
namespace {

TEST(HeldOutCourse, AnExponentialGoesOnAsItFell) {
  HeldOutCourse course;
  for (const double rate : {0.5, 0.02, -0.3}) {
    course.Set({});
    for (int i = 0; i < HeldOutCourse::kMinPoints; ++i) {
      EXPECT_TRUE(std::isinf(course.GainToComePct()));
      EXPECT_TRUE(std::isinf(course.MostGainToComePct()));
      const double progress = 0.6 + i * HeldOutCourse::kEvery;
      course.Add(progress, 0.1 * std::exp(-rate * progress));
    }
    const double left = 1 - course.points().back().progress;
    EXPECT_NEAR(course.GainToComePct(), 100 * (1 - std::exp(-rate * left)), 1e-9);
    EXPECT_NEAR(course.MostGainToComePct(), course.GainToComePct(), 1e-5);  // no scatter: 4e-7 by rounding
  }
}

// Whether a course that falls at `rate`, with normal noise of its logarithm, is stopped before its end.
bool IsStopped(double rate, double noise, double threshold_pct, std::mt19937* random) {
  HeldOutCourse course;
  std::normal_distribution<double> normal(0, noise);
  for (int i = 0; i < HeldOutCourse::kMostLooks; ++i) {
    const double progress = 0.6 + i * HeldOutCourse::kEvery;
    course.Add(progress, 0.1 * std::exp(-rate * progress + normal(*random)));
    if (course.MostGainToComePct() < threshold_pct) return true;
  }
  return false;
}

TEST(HeldOutCourse, NoiseDoesNotStopARunThatStillGains) {
  std::mt19937 random(7);
  constexpr int kRuns = 4000;
  for (const double noise : {1e-4, 1e-3, 1e-2}) {
    // At 96 % of the run, the last time that it is asked, 1 % is still to come; before, more.
    const double rate = -std::log(0.99) / 0.04;
    int stopped = 0;
    for (int run = 0; run < kRuns; ++run) stopped += IsStopped(rate, noise, 1, &random) ? 1 : 0;
    EXPECT_LE(stopped, HeldOutCourse::kFalseStops * kRuns) << noise;
  }
  // A level course whose scatter is a tenth of what is asked is stopped nearly always, one whose scatter
  // hides it is not.
  int level = 0, hidden = 0;
  for (int run = 0; run < kRuns; ++run) {
    level += IsStopped(0, 1e-3, 1, &random) ? 1 : 0;
    hidden += IsStopped(0, 3e-2, 1, &random) ? 1 : 0;
  }
  EXPECT_GT(level, 0.99 * kRuns);
  EXPECT_LT(hidden, 0.5 * kRuns);
}

}  // namespace
}  // namespace s2gs
