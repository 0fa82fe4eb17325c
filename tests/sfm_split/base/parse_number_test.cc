#include "sfm_split/base/parse_number.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <string>
#include <system_error>

namespace s2gs {
namespace {

template <typename T>
std::errc FaultOf(const std::string& text) {
  T value = 7;
  const std::errc fault = ParseNumber(text, &value);
  if (fault != std::errc()) EXPECT_EQ(value, T{7}) << text;
  return fault;
}

TEST(ParseNumber, ReadsAllOfTheText) {
  double real = 0;
  EXPECT_EQ(ParseNumber("-2.5e-3", &real), std::errc());
  EXPECT_EQ(real, -0.0025);
  int whole = 0;
  EXPECT_EQ(ParseNumber("-12", &whole), std::errc());
  EXPECT_EQ(whole, -12);
  for (const char* text : {"", " 1", "1 ", "1,5", "1.5x", "x", "+1", "--1"})
    EXPECT_EQ(FaultOf<double>(text), std::errc::invalid_argument) << text;
  for (const char* text : {"1.5", "1e3", "0x10"})
    EXPECT_EQ(FaultOf<int>(text), std::errc::invalid_argument) << text;
  EXPECT_EQ(FaultOf<uint32_t>("-1"), std::errc::invalid_argument);
}

TEST(ParseNumber, TellsWhatDoesNotFitFromWhatIsNoNumber) {
  EXPECT_EQ(FaultOf<double>("1e999"), std::errc::result_out_of_range);
  EXPECT_EQ(FaultOf<int32_t>("2147483648"), std::errc::result_out_of_range);
  EXPECT_EQ(FaultOf<int32_t>("2147483648x"), std::errc::invalid_argument);
  EXPECT_EQ(FaultOf<double>("1e999x"), std::errc::invalid_argument);
}

}  // namespace
}  // namespace s2gs
