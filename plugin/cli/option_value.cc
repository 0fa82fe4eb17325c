#include "plugin/cli/option_value.h"

#include <fmt/format.h>

#include <cmath>
#include <limits>
#include <system_error>

#include "sfm_split/base/parse_number.h"

namespace s2gs {
namespace {

template <typename T>
void ParseInteger(const std::string& text, T* value) {
  const std::errc fault = ParseNumber(text, value);
  if (fault == std::errc::result_out_of_range) {
    throw BadValue(fmt::format("does not fit: whole numbers from {} to {} do", std::numeric_limits<T>::min(),
                               std::numeric_limits<T>::max()));
  }
  if (fault != std::errc()) {
    const bool is_negative = text.size() > 1 && text[0] == '-' && text[1] >= '0' && text[1] <= '9';
    throw BadValue(std::is_unsigned_v<T> && is_negative
                       ? "is negative: a whole number of at least 0 is wanted"
                       : "is not a whole number");
  }
}

template <typename T>
void ParseReal(const std::string& text, T* value) {
  T parsed = 0;
  const std::errc fault = ParseNumber(text, &parsed);
  if (fault == std::errc::result_out_of_range) {
    throw BadValue("is too large or too close to 0 for a number");
  }
  if (fault != std::errc()) {
    if (text.find(',') != std::string::npos) throw BadValue("is not a number (decimals follow a point)");
    throw BadValue("is not a number");
  }
  if (!std::isfinite(parsed)) throw BadValue("is not a finite number");
  *value = parsed;
}

}  // namespace

void ParseValue(const std::string& text, bool* value) {
  if (text == "1" || text == "true") {
    *value = true;
  } else if (text == "0" || text == "false") {
    *value = false;
  } else {
    throw BadValue("is neither 0 nor 1");
  }
}
void ParseValue(const std::string& text, int32_t* value) { ParseInteger(text, value); }
void ParseValue(const std::string& text, int64_t* value) { ParseInteger(text, value); }
void ParseValue(const std::string& text, uint32_t* value) { ParseInteger(text, value); }
void ParseValue(const std::string& text, uint64_t* value) { ParseInteger(text, value); }
void ParseValue(const std::string& text, float* value) { ParseReal(text, value); }
void ParseValue(const std::string& text, double* value) { ParseReal(text, value); }
void ParseValue(const std::string& text, std::string* value) { *value = text; }
void ParseValue(const std::string& text, std::filesystem::path* value) {
  // Mostly a shell variable that was never set.
  if (text.empty()) throw BadValue("is an empty path");
  *value = text;
}

std::string FormatValue(bool value) { return value ? "1" : "0"; }
std::string FormatValue(int32_t value) { return fmt::format("{}", value); }
std::string FormatValue(int64_t value) { return fmt::format("{}", value); }
std::string FormatValue(uint32_t value) { return fmt::format("{}", value); }
std::string FormatValue(uint64_t value) { return fmt::format("{}", value); }
std::string FormatValue(float value) { return fmt::format("{}", value); }
std::string FormatValue(double value) { return fmt::format("{}", value); }
std::string FormatValue(const std::string& value) { return value; }
std::string FormatValue(const std::filesystem::path& value) { return value.string(); }

std::vector<std::string> SplitAtCommas(const std::string& text) {
  std::vector<std::string> parts;
  if (text.empty()) return parts;
  size_t begin = 0;
  while (true) {
    const size_t comma = text.find(',', begin);
    parts.push_back(text.substr(begin, comma - begin));
    if (comma == std::string::npos) return parts;
    begin = comma + 1;
  }
}

}  // namespace s2gs
