#include "sfm_split/base/statistics.h"

#include <gtest/gtest.h>

#include <cmath>
#include <optional>
#include <vector>

namespace s2gs {
namespace {

TEST(Summarize, OddAndEvenCounts) {
  const Summary odd = Summarize({5, 1, 3});
  EXPECT_EQ(odd.count, 3);
  EXPECT_DOUBLE_EQ(odd.mean, 3);
  EXPECT_DOUBLE_EQ(odd.median, 3);
  EXPECT_DOUBLE_EQ(odd.min, 1);
  EXPECT_DOUBLE_EQ(odd.max, 5);
  const Summary even = Summarize({8, 1, 2, 4});
  EXPECT_DOUBLE_EQ(even.mean, 3.75);
  EXPECT_DOUBLE_EQ(even.median, 3);
  EXPECT_DOUBLE_EQ(even.max, 8);
}

TEST(Summarize, NothingIsNotZero) {
  const Summary summary = Summarize({});
  EXPECT_EQ(summary.count, 0);
  EXPECT_TRUE(std::isnan(summary.mean));
  EXPECT_TRUE(std::isnan(summary.median));
  EXPECT_TRUE(std::isnan(summary.min));
  EXPECT_TRUE(std::isnan(summary.max));
}

TEST(LogPoissonTail, IsTheSumOfTheProbabilities) {
  EXPECT_EQ(LogPoissonTail(0, 2), 0);
  // 1 - e^-2 (1 + 2 + 2)
  EXPECT_NEAR(std::exp(LogPoissonTail(3, 2)), 1 - 5 * std::exp(-2.0), 1e-12);
  EXPECT_NEAR(std::exp(LogPoissonTail(1, 0.01)), 1 - std::exp(-0.01), 1e-12);
  EXPECT_LT(LogPoissonTail(1000, 2), -1000);
}

TEST(Statistics, AQuantileIsTheValueAtItsPlaceInTheOrder) {
  const std::vector<double> values = {9, 1, 7, 3, 5};
  for (int k = 0; k < 5; ++k) EXPECT_EQ(Quantile(values, k / 4.0), 1 + 2 * k);
  EXPECT_EQ(Quantile(values, 0.74), 5);  // rounded down
  EXPECT_EQ(Quantile(std::vector<float>{2}, 0.9), 2);
}

TEST(Statistics, ALineIsFoundExactlyAndItsErrorsCancel) {
  std::vector<Eigen::Vector2d> points;
  for (const double x : {0.0, 1.0, 2.0, 5.0, 7.0}) points.emplace_back(x, 3 - 0.5 * x);
  std::optional<Line> line = FitLine(points);
  ASSERT_TRUE(line);
  EXPECT_NEAR(line->start, 3, 1e-14);
  EXPECT_NEAR(line->slope, -0.5, 1e-15);
  // Least squares: errors sum to nothing, alone and times x.
  points[1].y() += 0.3;
  points[3].y() -= 0.2;
  line = FitLine(points);
  double sum = 0;
  double moment = 0;
  for (const Eigen::Vector2d& p : points) {
    const double error = p.y() - line->start - line->slope * p.x();
    sum += error;
    moment += error * p.x();
  }
  EXPECT_NEAR(sum, 0, 1e-14);
  EXPECT_NEAR(moment, 0, 1e-13);
  using Points = std::vector<Eigen::Vector2d>;
  EXPECT_FALSE(FitLine(Points{Eigen::Vector2d(2, 1), Eigen::Vector2d(2, 3)}));
  EXPECT_FALSE(FitLine(Points{Eigen::Vector2d(2, 1)}));
  EXPECT_FALSE(FitLine(Points()));
}

}  // namespace
}  // namespace s2gs
