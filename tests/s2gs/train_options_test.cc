#include "s2gs/train_options.h"

#include <gtest/gtest.h>

#include <cmath>

namespace s2gs {
namespace {

TEST(TrainOptions, CheckNamesFieldAndBound) {
  EXPECT_FALSE(TrainOptions().Check().has_value());
  TrainOptions options;
  options.settle_until = 0.1;
  const OptionCheck fault = options.Check();
  ASSERT_TRUE(fault.has_value());
  EXPECT_EQ(fault->field, "settle_until");
  options = {};
  options.centre_rate = std::nan("");
  EXPECT_TRUE(options.Check().has_value());
}

TEST(TrainOptions, SchedulesAreThoseOf2dgsOver30000Iterations) {
  const TrainOptions options;
  const auto at = [&](double iteration) {
    return MomentAt(options, iteration / 30000, SceneBodies::kBoth, false, false);
  };
  EXPECT_FLOAT_EQ(at(0).rates.centre, 1.6e-4F);
  EXPECT_FLOAT_EQ(at(30000).rates.centre, 1.6e-6F);
  EXPECT_NEAR(at(15000).rates.centre, 1.6e-5, 1e-9);  // log-linear
  EXPECT_EQ(at(999).sh_degree, 0);
  EXPECT_EQ(at(1000).sh_degree, 1);
  EXPECT_EQ(at(2000).sh_degree, 2);
  EXPECT_EQ(at(29000).sh_degree, 3);
  EXPECT_FALSE(at(499).grows);
  EXPECT_TRUE(at(501).grows);
  EXPECT_FALSE(at(15001).grows);
  EXPECT_EQ(at(6999).weights.normal, 0);
  EXPECT_GT(at(7001).weights.normal, 0);
  EXPECT_EQ(at(4999).weights.entropy_3d, 0);
  EXPECT_GT(at(5001).weights.entropy_3d, 0);
}

TEST(TrainOptions, DistortionWaitsUntilPIsSettled) {
  TrainOptions options;
  options.distortion_weight = 30'000;
  const auto weight = [&](double progress, SceneBodies bodies, bool foreground_frozen) {
    return MomentAt(options, progress, bodies, foreground_frozen, false).weights.distortion;
  };
  const auto full = static_cast<float>(options.distortion_weight);
  EXPECT_EQ(weight(0.5, SceneBodies::kBoth, false), 0);
  EXPECT_EQ(weight(0.5, SceneBodies::kBoth, true), full);
  EXPECT_EQ(weight(options.distortion_from - 0.01, SceneBodies::kObjectOnly, false), 0);
  EXPECT_EQ(weight(options.distortion_from + 0.01, SceneBodies::kObjectOnly, false), full);
}

}  // namespace
}  // namespace s2gs
