#pragma once

#include <filesystem>

namespace s2gs {

/// Throws UserError unless a file can be written at `path`: its folder exists and may be written in, and
/// `path` is no folder. For the start of what takes long and writes at its end.
void RequireWritable(const std::filesystem::path& path);

}  // namespace s2gs
