#include "plugin/cli/project_file.h"

#include <string_view>

#include "plugin/cli/byte_order_mark.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"

namespace s2gs {
namespace {

constexpr uint64_t kMaxProjectFileBytes = 1 << 20;

std::string_view Trimmed(std::string_view text) {
  constexpr std::string_view kSpaces = " \t\r\v\f";
  const size_t begin = text.find_first_not_of(kSpaces);
  if (begin == std::string_view::npos) return {};
  return text.substr(begin, text.find_last_not_of(kSpaces) - begin + 1);
}

bool IsName(std::string_view text) {
  if (text.empty()) return false;
  for (const char c : text) {
    const bool is_letter = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z');
    if (!is_letter && (c < '0' || c > '9') && c != '_' && c != '.' && c != '-') return false;
  }
  return true;
}

}  // namespace

std::vector<ProjectFileEntry> ReadProjectFile(const std::filesystem::path& path) {
  return ParseProjectFile(ReadWholeFile(path, kMaxProjectFileBytes, "Check --project_path"), path);
}

std::vector<ProjectFileEntry> ParseProjectFile(std::string_view text, const std::filesystem::path& path) {
  std::string_view rest = WithoutByteOrderMark(text);
  std::vector<ProjectFileEntry> entries;
  std::string group;
  for (int line = 1; !rest.empty(); ++line) {
    const size_t end = rest.find('\n');
    const std::string_view content = Trimmed(rest.substr(0, end));
    rest.remove_prefix(end == std::string_view::npos ? rest.size() : end + 1);
    const auto fail = [&](const std::string& problem) {
      throw UserError(path, "line " + std::to_string(line) + " " + problem,
                      "Lines are `key = value`, `[Group]`, or comments that begin with #");
    };
    if (content.empty() || content[0] == '#' || content[0] == ';') continue;
    if (content[0] == '[') {
      const std::string_view name =
          content.back() == ']' ? Trimmed(content.substr(1, content.size() - 2)) : "";
      if (!IsName(name)) fail("is no [Group]");
      group = std::string(name) + ".";
      continue;
    }
    const size_t equals = content.find('=');
    if (equals == std::string_view::npos) fail("has no =");
    const std::string_view key = Trimmed(content.substr(0, equals));
    std::string_view value = Trimmed(content.substr(equals + 1));
    if (!IsName(key)) fail("has no option's name before the =");
    if (value.size() >= 2 && value.front() == '"' && value.back() == '"') {
      value = value.substr(1, value.size() - 2);
    }
    if (value.find('\0') != std::string_view::npos) fail("contains a zero byte");
    entries.push_back({group + std::string(key), std::string(value), line});
  }
  return entries;
}

}  // namespace s2gs
