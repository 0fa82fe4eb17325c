#include "sfm_split/adjust/joint_model.h"

#include <gtest/gtest.h>

#include <cmath>

namespace s2gs {
namespace {

ModelTest Compare(double simple_cost, double general_cost, int extra) {
  JointSolved simple;
  simple.cost = simple_cost;
  simple.parameters = 20;
  JointSolved general;
  general.cost = general_cost;
  general.parameters = 20 + extra;
  general.residuals = 200;
  ModelTest test;
  CompareModels(simple, general, &test);
  EXPECT_TRUE(test.fitted);
  EXPECT_EQ(test.extra_parameters, extra);
  return test;
}

TEST(CompareModels, TakesTheGeneralOneByTheBayesianInformationCriterion) {
  const ModelTest taken = Compare(120, 100, 5);
  EXPECT_NEAR(taken.f_statistic, (20.0 / 5) / (100.0 / 175), 1e-12);
  EXPECT_NEAR(taken.bic_gain, 200 * std::log(1.2) - 5 * std::log(200.0), 1e-12);
  EXPECT_TRUE(taken.accepted);
  const ModelTest left = Compare(120, 100, 7);
  EXPECT_LT(left.bic_gain, 0);
  EXPECT_FALSE(left.accepted);
}

// One that has nothing more to adjust, or nothing left to explain, is no comparison.
TEST(CompareModels, SaysNothingWhereThereIsNothingToCompare) {
  for (const ModelTest& test : {Compare(120, 100, 0), Compare(120, 100, -2), Compare(120, 0, 5)}) {
    EXPECT_EQ(test.f_statistic, 0);
    EXPECT_EQ(test.bic_gain, 0);
    EXPECT_FALSE(test.accepted);
  }
}

}  // namespace
}  // namespace s2gs
