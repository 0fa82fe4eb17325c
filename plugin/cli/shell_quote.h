#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace s2gs {

/// A command line that can be pasted into a POSIX shell: words in single quotes where they need them.
std::string ShellQuoted(const std::vector<std::string>& words);

/// The words of a line as a POSIX shell has them, from spaces, quotes and backslashes alone: nothing is
/// expanded. Nothing when a quote is not closed.
std::optional<std::vector<std::string>> ShellWords(std::string_view line);

}  // namespace s2gs
