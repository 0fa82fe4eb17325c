#include "plugin/colmap/find_executable.h"

#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <string_view>
#include <system_error>

#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

bool IsExecutableFile(const fs::path& path) {
  std::error_code ec;
  return fs::is_regular_file(path, ec) && ::access(path.c_str(), X_OK) == 0;
}

}  // namespace

fs::path FindExecutable(const std::string& name, const fs::path& given, const std::string& use,
                        const std::string& remedy) {
  std::error_code ec;
  if (!given.empty()) {
    const fs::path path = fs::is_directory(given, ec) ? given / name : given;
    if (IsExecutableFile(path)) return fs::absolute(path);
    throw UserError(path, fs::exists(path, ec) ? "is not an executable file" : "no such file", remedy);
  }
  const char* search_path = std::getenv("PATH");
  std::string_view rest = search_path != nullptr ? search_path : "";
  while (!rest.empty()) {
    const size_t end = std::min(rest.find(':'), rest.size());
    const fs::path folder(rest.substr(0, end));
    rest.remove_prefix(std::min(end + 1, rest.size()));
    if (!folder.empty() && IsExecutableFile(folder / name)) return fs::absolute(folder / name);
  }
  throw UserError(name, "is not on PATH" + use, remedy);
}

}  // namespace s2gs
