#include "tests/support/measured_bound.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <fstream>
#include <iomanip>
#include <sstream>

namespace s2gs {
namespace {

// JSON has no NaN and no infinities.
std::string Number(double value) {
  if (!std::isfinite(value)) return "null";
  std::ostringstream text;
  text << std::setprecision(9) << value;
  return text.str();
}

}  // namespace

void ExpectWithin(const char* row, const std::string& what, const std::string& on, double measured,
                  double bound) {
  const bool holds = measured <= bound;
  EXPECT_TRUE(holds) << row << ", " << what << " (" << on << "): " << measured << ", at most " << bound;
  const testing::TestInfo* test = testing::UnitTest::GetInstance()->current_test_info();
  testing::Test::RecordProperty(what + ", " + on, Number(measured) + " of " + Number(bound));
  const char* path = std::getenv("S2GS_NUMERICS");
  if (path == nullptr) return;
  std::ofstream file(path, std::ios::app);
  file << R"({"row": ")" << row << R"(", "what": ")" << what << R"(", "on": ")" << on << R"(", "measured": )"
       << Number(measured) << R"(, "bound": )" << Number(bound) << R"(, "holds": )"
       << (holds ? "true" : "false") << R"(, "test": ")"
       << (test == nullptr ? "" : std::string(test->test_suite_name()) + "." + test->name()) << "\"}\n";
}

}  // namespace s2gs
