#pragma once

#include <filesystem>
#include <optional>
#include <string>

namespace s2gs {

/// The path without symbolic links and "..", as far as it exists; "folder/" and "folder" are one. Throws
/// UserError when it cannot be followed.
std::filesystem::path ResolvedPath(const std::filesystem::path& path);

/// Whether a path is the folder or lies below it, by their names alone.
bool IsWithin(const std::filesystem::path& path, const std::filesystem::path& folder);

/// A symbolic link through which what is written below `root` would come to lie outside it or replace another
/// file: on the way to `path`, `path` itself, or anywhere below it. Links to folders below `root` do not
/// count, links that lead nowhere do. Nothing when there is none, or when `path` does not lie below `root` by
/// its name: it was then given as it is. \return the link.
std::optional<std::filesystem::path> FindLinkOut(const std::filesystem::path& root,
                                                 const std::filesystem::path& path);

/// Throws UserError when there is such a link.
void RequireNoLinkOut(const std::filesystem::path& root, const std::filesystem::path& path);

}  // namespace s2gs
