#include "sfm_split/base/number_text.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

TEST(NumberText, IsShortAndReadsBackAsTheSame) {
  EXPECT_EQ(NumberText(0.5), "0.5");
  EXPECT_EQ(NumberText(100), "100");
  EXPECT_EQ(NumberText(-1e-9), "-1e-09");
  EXPECT_EQ(NumberText(std::numeric_limits<double>::infinity()), "inf");
  EXPECT_EQ(NumberText(std::nan("")), "nan");
  RandomNumbers random(1);
  for (int i = 0; i < 1000; ++i) {
    const double value = random.Normal() * std::pow(10.0, 200 * random.Normal() / 3);
    EXPECT_EQ(std::stod(NumberText(value)), value);
  }
  for (const double value : {std::numeric_limits<double>::max(), std::numeric_limits<double>::lowest()}) {
    EXPECT_EQ(std::stod(NumberText(value)), value);
  }
}

}  // namespace
}  // namespace s2gs
