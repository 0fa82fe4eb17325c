#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace s2gs {

/// Number of single-character edits (insert, delete, replace, swap of neighbours) between two words.
int EditDistance(std::string_view a, std::string_view b);

/// The candidates nearest to a misspelt word, best first, at most `max_count`. Case and '-' against '_' do
/// not count as differences. Empty when nothing is near enough to be what was meant.
std::vector<std::string> NearestWords(std::string_view word, const std::vector<std::string>& candidates,
                                      size_t max_count = 3);

}  // namespace s2gs
