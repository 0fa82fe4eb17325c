#include "sfm_split/base/statistics.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <optional>
#include <random>
#include <vector>

#include "sfm_split/base/angles.h"

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

// Half-normal errors at the middles of so many equal shares, up to four standard deviations.
std::vector<double> NormalErrors(int count) {
  std::vector<double> errors;
  double share = 0;
  for (double x = 0.0005; x < 4; x += 0.001) {
    share += 0.001 * std::sqrt(2 / kPi) * std::exp(-x * x / 2);
    while (share * count > static_cast<double>(errors.size()) + 0.5) errors.push_back(x);
  }
  return errors;
}

TEST(VarianceOfChosen, IsThatOfNormalErrorsThatAreCutOff) {
  const std::vector<double> errors = NormalErrors(20000);
  for (const double bound : {0.7, 1.0, 1.5, 2.0, 3.0}) {
    const double inside = std::erf(bound / std::sqrt(2));
    const double at_bound = bound * std::sqrt(2 / kPi) * std::exp(-bound * bound / 2);
    const double expected = std::pow(inside / (inside - at_bound), 2);
    // Measured: 7 % at most, as errors near the bound stand for those at it.
    EXPECT_NEAR(VarianceOfChosen(errors, bound) / expected, 1, 0.1) << bound;
  }
}

// A mean of what lies within a bound of it, found by going on from one to the next.
TEST(VarianceOfChosen, IsWhatAMeanVariesByThatChoosesItsData) {
  constexpr int kDraws = 2000;
  constexpr int kData = 300;
  constexpr double kBound = 1;
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  double squares = 0;
  double stated = 0;
  double seeming = 0;
  for (int draw = 0; draw < kDraws; ++draw) {
    std::vector<double> data;
    for (int k = 0; k < kData; ++k) data.push_back(normal(random));
    double mean = 0;
    double variance = 0;
    for (int round = 0; round < 100; ++round) {
      double sum = 0;
      double sum_of_squares = 0;
      int count = 0;
      for (const double x : data) {
        if (std::abs(x - mean) > kBound) continue;
        sum += x;
        sum_of_squares += (x - mean) * (x - mean);
        ++count;
      }
      variance = sum_of_squares / count / count;
      const double next = sum / count;
      if (next == mean) break;
      mean = next;
    }
    std::vector<double> errors;
    for (const double x : data) errors.push_back(std::abs(x - mean));
    squares += mean * mean / kDraws;
    seeming += variance / kDraws;
    stated += VarianceOfChosen(errors, kBound) * variance / kDraws;
  }
  // Measured 8.9 and 1.43: few data near the bound tell their density to a sixth.
  EXPECT_GT(squares, 7 * seeming);
  EXPECT_NEAR(stated / squares, 1.2, 0.5);
}

TEST(VarianceOfChosen, IsOneWhereNoErrorIsNearTheBound) {
  EXPECT_EQ(VarianceOfChosen({0.1, 0.2, 0.3, 0.1, 8}, 2), 1);
  EXPECT_EQ(VarianceOfChosen({}, 1), 1);
  const double none = std::numeric_limits<double>::infinity();
  EXPECT_EQ(VarianceOfChosen({0.1, 0.2, none, std::nan("")}, 2), 1);
}

// Where errors are spread evenly they tell nothing; how little is known from so many.
TEST(VarianceOfChosen, IsLargeAndFiniteWhereErrorsAreSpreadEvenly) {
  std::vector<double> errors;
  for (int k = 0; k < 1000; ++k) errors.push_back(0.002 * k);
  const double few = VarianceOfChosen(errors, 1);
  for (int k = 0; k < 9000; ++k) errors.push_back(2.0 / 9000 * k);
  const double many = VarianceOfChosen(errors, 1);
  EXPECT_GT(few, 80);
  EXPECT_GT(many, 5 * few);
  EXPECT_TRUE(std::isfinite(many));
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
