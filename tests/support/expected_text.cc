#include "tests/support/expected_text.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <regex>
#include <sstream>

#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

// One in a number's last digit.
double LastDigit(const std::string& number) {
  const size_t e = number.find_first_of("eE");
  const double power = e == std::string::npos ? 1 : std::pow(10.0, std::stod(number.substr(e + 1)));
  const size_t point = number.find('.');
  const size_t end = e == std::string::npos ? number.size() : e;
  return point == std::string::npos ? power : power * std::pow(10.0, -static_cast<double>(end - point - 1));
}

// What two lines have beside numbers, and the numbers.
struct Words {
  std::string text;
  std::vector<std::string> numbers;
};

Words Split(const std::string& line) {
  static const std::regex kNumber(R"(-?\d+(\.\d+)?([eE][-+]?\d+)?)");
  Words words;
  auto from = line.begin();
  for (std::sregex_iterator at(line.begin(), line.end(), kNumber), end; at != end; ++at) {
    words.text.append(from, (*at)[0].first);
    words.text += '#';
    words.numbers.push_back(at->str());
    from = (*at)[0].second;
  }
  words.text.append(from, line.end());
  return words;
}

bool AreEqual(const std::string& a, const std::string& b) {
  if (a == b) return true;
  const bool is_whole = (a + b).find_first_of(".eE") == std::string::npos;
  const double x = std::stod(a);
  const double y = std::stod(b);
  // Counts are exact; what is nothing but rounding is nothing.
  if (is_whole) return false;
  if (std::abs(x) < 1e-9 && std::abs(y) < 1e-9) return true;
  const double digit = std::max(LastDigit(a), LastDigit(b));
  return std::abs(x - y) <= 1e-4 * std::abs(y) + (digit < 1e-5 ? 0 : 1.01 * digit);
}

bool AreEqualLines(const std::string& a, const std::string& b) {
  if (a == b) return true;
  const Words x = Split(a);
  const Words y = Split(b);
  if (x.text != y.text || x.numbers.size() != y.numbers.size()) return false;
  return std::equal(x.numbers.begin(), x.numbers.end(), y.numbers.begin(), AreEqual);
}

}  // namespace

void ExpectText(const std::string& text, const std::string& path) {
  const std::filesystem::path file = std::filesystem::path(S2GS_TESTS_FOLDER) / path;
  const char* const write = std::getenv("S2GS_WRITE_EXPECTED");
  if (write != nullptr && std::string(write) == "1") {
    WriteAll(file, text);
    ADD_FAILURE() << file << " was written: look at it";
    return;
  }
  std::istringstream is(text);
  std::istringstream expected(ReadAll(file));
  std::string line;
  std::string expected_line;
  for (int number = 1;; ++number) {
    const bool has = !!std::getline(is, line);
    const bool is_expected = !!std::getline(expected, expected_line);
    ASSERT_EQ(has, is_expected) << path << " ends at line " << number << ": " << (has ? line : expected_line);
    if (!has) return;
    ASSERT_TRUE(AreEqualLines(line, expected_line))
        << path << ":" << number << "\n  is       " << line << "\n  expected " << expected_line;
  }
}

}  // namespace s2gs
