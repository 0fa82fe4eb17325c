#pragma once

#include <charconv>
#include <string_view>
#include <system_error>
#include <type_traits>

namespace s2gs {

/// Reads all of a text as one number, in the same way in every locale.
/// \return  std::errc() where it is one; std::errc::result_out_of_range where it is one that T cannot hold;
///          std::errc::invalid_argument where it is none, or something follows it. `value` then stays.
template <typename T>
std::errc ParseNumber(std::string_view text, T* value) {
  static_assert(std::is_arithmetic_v<T>);
  T parsed{};
  const auto [end, fault] = std::from_chars(text.data(), text.data() + text.size(), parsed);
  if (end != text.data() + text.size()) return std::errc::invalid_argument;
  if (fault == std::errc()) *value = parsed;
  return fault;
}

}  // namespace s2gs
