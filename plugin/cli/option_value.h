#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

namespace s2gs {

/// Thrown by ParseValue; what() continues a sentence that begins with the value, e.g. "is not a number".
class BadValue : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Strict conversion of an option's text: the whole text must be the value. Numbers are finite and use a
/// point for decimals whatever the locale; booleans are 0, 1, false or true. Throws BadValue.
void ParseValue(const std::string& text, bool* value);
void ParseValue(const std::string& text, int32_t* value);
void ParseValue(const std::string& text, int64_t* value);
void ParseValue(const std::string& text, uint32_t* value);
void ParseValue(const std::string& text, uint64_t* value);
void ParseValue(const std::string& text, float* value);
void ParseValue(const std::string& text, double* value);
void ParseValue(const std::string& text, std::string* value);
void ParseValue(const std::string& text, std::filesystem::path* value);

/// The inverse: the shortest text that ParseValue reads back as the same value.
std::string FormatValue(bool value);
std::string FormatValue(int32_t value);
std::string FormatValue(int64_t value);
std::string FormatValue(uint32_t value);
std::string FormatValue(uint64_t value);
std::string FormatValue(float value);
std::string FormatValue(double value);
std::string FormatValue(const std::string& value);
std::string FormatValue(const std::filesystem::path& value);

/// Splits at commas; an empty text has no parts.
std::vector<std::string> SplitAtCommas(const std::string& text);

template <typename T>
void ParseValue(const std::string& text, std::optional<T>* value) {
  T parsed{};
  ParseValue(text, &parsed);
  *value = std::move(parsed);
}

template <typename T>
std::string FormatValue(const std::optional<T>& value) {
  return value.has_value() ? FormatValue(*value) : std::string();
}

/// Lists are separated by commas.
template <typename T>
void ParseValue(const std::string& text, std::vector<T>* value) {
  std::vector<T> parsed;
  for (const std::string& part : SplitAtCommas(text)) {
    T element{};
    ParseValue(part, &element);
    parsed.push_back(std::move(element));
  }
  *value = std::move(parsed);
}

template <typename T>
std::string FormatValue(const std::vector<T>& values) {
  std::string text;
  for (const T& value : values) text += (text.empty() ? "" : ",") + FormatValue(value);
  return text;
}

template <typename T>
struct IsVector : std::false_type {};
template <typename T>
struct IsVector<std::vector<T>> : std::true_type {};
template <typename T>
struct IsOptional : std::false_type {};
template <typename T>
struct IsOptional<std::optional<T>> : std::true_type {};

/// How the help writes the kind of value that an option takes.
template <typename T>
std::string ValueKind() {
  if constexpr (IsOptional<T>::value) {
    return ValueKind<typename T::value_type>();
  } else if constexpr (IsVector<T>::value) {
    return ValueKind<typename T::value_type>() + ",...";
  } else if constexpr (std::is_same_v<T, bool>) {
    return "0|1";
  } else if constexpr (std::is_integral_v<T>) {
    return "INT";
  } else if constexpr (std::is_floating_point_v<T>) {
    return "NUMBER";
  } else if constexpr (std::is_same_v<T, std::filesystem::path>) {
    return "PATH";
  } else {
    static_assert(std::is_same_v<T, std::string>, "no conversion for this type of option");
    return "TEXT";
  }
}

}  // namespace s2gs
