#include "plugin/batch/batch_list.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdint>
#include <exception>
#include <map>
#include <optional>
#include <system_error>

#include "plugin/cli/byte_order_mark.h"
#include "plugin/cli/shell_quote.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/resolved_path.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr uint64_t kMaxListBytes = uint64_t{1} << 26;
constexpr const char* kColumnsRemedy =
    "Let its first line be \"images,workspace,options\", and give each object a line below it";

std::string Trimmed(std::string_view text) {
  const size_t begin = text.find_first_not_of(" \t");
  if (begin == std::string_view::npos) return "";
  return std::string(text.substr(begin, text.find_last_not_of(" \t") + 1 - begin));
}

// The cells of a line; nothing when a quote is not closed or stands where none may.
std::optional<std::vector<std::string>> Cells(std::string_view line, char separator) {
  std::vector<std::string> cells;
  for (size_t at = 0;;) {
    std::string cell;
    const size_t begin = line.find_first_not_of(' ', at);
    if (begin != std::string_view::npos && line[begin] == '"') {
      size_t i = begin + 1;
      for (; i < line.size(); ++i) {
        if (line[i] == '"' && line.substr(i, 2) != "\"\"") break;
        if (line[i] == '"') ++i;
        cell += line[i];
      }
      if (i == line.size()) return std::nullopt;
      at = std::min(line.find(separator, i + 1), line.size());
      if (!Trimmed(line.substr(i + 1, at - i - 1)).empty()) return std::nullopt;
    } else {
      const size_t end = std::min(line.find(separator, at), line.size());
      cell = Trimmed(line.substr(at, end - at));
      at = end;
    }
    cells.push_back(std::move(cell));
    if (at == line.size()) return cells;
    ++at;
  }
}

// Which cell of a row is what; -1 where there is no such column.
struct Columns {
  char separator = ',';
  int images = -1, workspace = -1, options = -1;
  size_t count = 0;
};

Columns ParseColumns(std::string_view line, const fs::path& path) {
  Columns columns;
  for (const char separator : {',', ';', '\t'}) {
    if (line.find(separator) == std::string_view::npos) continue;
    columns.separator = separator;
    break;
  }
  const auto names = Cells(line, columns.separator);
  const auto fail = [&](const std::string& problem) { throw UserError(path, problem, kColumnsRemedy); };
  if (!names) fail("its first line names no columns: a quote is not closed");
  columns.count = names->size();
  for (size_t i = 0; i < names->size(); ++i) {
    const std::string& name = (*names)[i];
    int* column = name == "images"      ? &columns.images
                  : name == "workspace" ? &columns.workspace
                  : name == "options"   ? &columns.options
                                        : nullptr;
    if (column == nullptr) fail("\"" + name + "\" in its first line is no column");
    if (*column >= 0) fail("its first line names \"" + name + "\" twice");
    *column = static_cast<int>(i);
  }
  if (columns.images < 0 || columns.workspace < 0) {
    fail(std::string("its first line does not name the column ") +
         (columns.images < 0 ? "images" : "workspace"));
  }
  return columns;
}

BatchObject ParseRow(std::string_view text, int line, const Columns& columns, const fs::path& folder,
                     const CheckScanLine& check) {
  BatchObject object;
  object.line = line;
  const auto cells = Cells(text, columns.separator);
  if (!cells) {
    object.fault = "a quote is not closed, or something follows it";
    return object;
  }
  const auto cell = [&](int column) {
    return column >= 0 && static_cast<size_t>(column) < cells->size() ? (*cells)[column] : std::string();
  };
  if (!cell(columns.images).empty()) object.images = folder / cell(columns.images);
  if (!cell(columns.workspace).empty()) object.workspace = folder / cell(columns.workspace);
  if (cells->size() > columns.count) {
    object.fault = fmt::format(
        "it has {} cells, and there are {} columns. Put cells that have a \"{}\" in "
        "double quotes",
        cells->size(), columns.count, columns.separator);
    return object;
  }
  if (object.images.empty() || object.workspace.empty()) {
    object.fault = std::string("it does not say which ") +
                   (object.images.empty() ? "folder of images" : "workspace") + " it is about";
    return object;
  }
  const auto words = ShellWords(cell(columns.options));
  if (!words) {
    object.fault = "a quote in its options is not closed";
    return object;
  }
  object.options = *words;
  std::error_code ec;
  if (!fs::is_directory(object.images, ec) && !fs::is_regular_file(object.images, ec)) {
    object.fault = object.images.string() + ": there is no such folder of photos, and no such video";
    return object;
  }
  try {
    check(ScanLine(object));
  } catch (const Interrupted&) {
    throw;
  } catch (const std::exception& error) {
    object.fault = error.what();
  }
  return object;
}

// The line of a folder that is `path` or holds it; 0 for none.
int LineAbove(const std::map<fs::path, int>& lines, fs::path path) {
  for (;; path = path.parent_path()) {
    const auto found = lines.find(path);
    if (found != lines.end()) return found->second;
    if (!path.has_relative_path()) return 0;
  }
}

// Two objects in one workspace would overwrite each other, and photos of one among another's be taken for its
// own.
class Places {
 public:
  explicit Places(const std::vector<BatchObject>& objects) {
    for (const BatchObject& object : objects) {
      if (object.fault.empty()) images_.emplace(ResolvedPath(object.images), object.line);
    }
  }

  // Nothing when all is well: the object's workspace is then known to those that follow.
  std::string FaultOf(const BatchObject& object) {
    const fs::path own = ResolvedPath(object.workspace);
    const auto next = workspaces_.upper_bound(own);
    int line = LineAbove(workspaces_, own);
    const char* how = workspaces_.count(own) > 0 ? "is also that of" : "lies in that of";
    if (line == 0 && next != workspaces_.end() && IsWithin(next->first, own)) {
      line = next->second;
      how = "holds that of";
    }
    if (line == 0 && own.has_parent_path()) {
      line = LineAbove(images_, own);
      how = "lies among the photos of";
    }
    if (line != 0) return fmt::format("{}: the workspace {} line {}", object.workspace.string(), how, line);
    workspaces_[own] = object.line;
    return "";
  }

 private:
  std::map<fs::path, int> images_, workspaces_;  // lines; what lies in a folder follows it
};

void FaultSharedPlaces(std::vector<BatchObject>* objects) {
  Places places(*objects);
  for (BatchObject& object : *objects) {
    if (!object.fault.empty()) continue;
    try {
      object.fault = places.FaultOf(object);
    } catch (const UserError& error) {
      object.fault = error.what();
    }
  }
}

}  // namespace

std::vector<BatchObject> ParseBatchList(std::string_view text, const fs::path& path, const fs::path& folder,
                                        const CheckScanLine& check) {
  text = WithoutByteOrderMark(text);
  std::optional<Columns> columns;
  std::vector<BatchObject> objects;
  for (int number = 1; !text.empty(); ++number) {
    const size_t end = std::min(text.find('\n'), text.size());
    std::string_view line = text.substr(0, end);
    text.remove_prefix(std::min(end + 1, text.size()));
    if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
    if (Trimmed(line).empty() || line.front() == '#') continue;
    if (!columns) {
      columns = ParseColumns(line, path);
    } else {
      objects.push_back(ParseRow(line, number, *columns, folder, check));
    }
  }
  if (objects.empty()) throw UserError(path, "it lists no object", kColumnsRemedy);
  FaultSharedPlaces(&objects);
  return objects;
}

std::vector<BatchObject> ReadBatchList(const fs::path& path, const CheckScanLine& check) {
  return ParseBatchList(ReadWholeFile(path, kMaxListBytes, "Check --list"), path, path.parent_path(), check);
}

std::vector<std::string> ScanLine(const BatchObject& object) {
  std::vector<std::string> line = {"--workspace_path", object.workspace.string(), "--image_path",
                                   object.images.string()};
  line.insert(line.end(), object.options.begin(), object.options.end());
  return line;
}

}  // namespace s2gs
