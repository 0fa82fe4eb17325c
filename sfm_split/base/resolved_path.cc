#include "sfm_split/base/resolved_path.h"

#include <algorithm>
#include <system_error>

#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

// Where it leads to, or would if that existed.
fs::path TargetOf(const fs::path& link) {
  std::error_code ec;
  fs::path target = fs::canonical(link, ec);
  if (!ec) return target;
  return (link.parent_path() / fs::read_symlink(link, ec)).lexically_normal();
}

bool LeadsOut(const fs::path& path, const fs::path& resolved_root) {
  std::error_code ec;
  if (!fs::is_symlink(path, ec)) return false;
  const fs::path target = fs::canonical(path, ec);
  // A file below the root may be a photo: only folders are another place for the same.
  return ec || !IsWithin(target, resolved_root) || !fs::is_directory(target, ec);
}

}  // namespace

fs::path ResolvedPath(const fs::path& path) {
  std::error_code ec;
  fs::path resolved = fs::weakly_canonical(fs::absolute(path, ec), ec);
  if (ec) {
    throw UserError(path, "cannot be followed (" + ec.message() + ")", "Check the links on the way to it");
  }
  return resolved.has_filename() ? resolved : resolved.parent_path();
}

bool IsWithin(const fs::path& path, const fs::path& folder) {
  return std::mismatch(folder.begin(), folder.end(), path.begin(), path.end()).first == folder.end();
}

std::optional<fs::path> FindLinkOut(const fs::path& root, const fs::path& path) {
  const fs::path below = path.lexically_normal().lexically_relative(root.lexically_normal());
  if (below.empty() || *below.begin() == "..") return std::nullopt;
  const fs::path resolved_root = ResolvedPath(root);
  fs::path way = root;
  for (const fs::path& part : below) {
    if (part.empty() || part == ".") continue;
    way /= part;
    if (LeadsOut(way, resolved_root)) return way;
  }
  std::error_code ec;
  fs::recursive_directory_iterator entry(way, fs::directory_options::skip_permission_denied, ec);
  for (const fs::recursive_directory_iterator end; !ec && entry != end; entry.increment(ec)) {
    if (LeadsOut(entry->path(), resolved_root)) return entry->path();
  }
  return std::nullopt;
}

void RequireNoLinkOut(const fs::path& root, const fs::path& path) {
  const std::optional<fs::path> link = FindLinkOut(root, path);
  if (!link) return;
  const fs::path target = TargetOf(*link);
  const bool is_outside = !IsWithin(target, ResolvedPath(root));
  throw UserError(*link,
                  "is a symbolic link that leads to " + target.string() + ", " +
                      (is_outside ? "outside " + root.string() : "another file") +
                      ": nothing is written there",
                  "Remove the link, or replace it by a folder or a copy");
}

}  // namespace s2gs
