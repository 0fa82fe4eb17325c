#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace s2gs {

/// One `key = value` of a project file.
struct ProjectFileEntry {
  std::string name;   ///< the option's full name: "key", or "Group.key" below a line "[Group]".
  std::string value;  ///< without surrounding spaces and without one pair of double quotes; may be empty.
  int line = 0;       ///< from 1.
};

/// Reads a project file: `key = value` lines, first those without a group, then those below `[Group]` lines.
/// Lines that begin with # or ; are comments. Throws UserError with path and line for anything else.
std::vector<ProjectFileEntry> ReadProjectFile(const std::filesystem::path& path);

/// The same from a text; `path` is for messages.
std::vector<ProjectFileEntry> ParseProjectFile(std::string_view text, const std::filesystem::path& path);

}  // namespace s2gs
