#pragma once

#include <string>
#include <vector>

namespace s2gs {

/// A command line that can be pasted into a POSIX shell: words in single quotes where they need them.
std::string ShellQuoted(const std::vector<std::string>& words);

}  // namespace s2gs
