#include "plugin/stage/angle_list.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <string_view>
#include <system_error>

#include "plugin/cli/byte_order_mark.h"
#include "plugin/stage/json_file.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/image_name.h"
#include "sfm_split/base/lower_case.h"
#include "sfm_split/base/parse_number.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr uint64_t kMaxListBytes = uint64_t{1} << 26;
constexpr size_t kMaxLineLength = 4096;
constexpr double kMaxAngleDeg = 1e6;
constexpr const char* kListRemedy = "Give one NAME,ANGLE a line, in degrees";
constexpr std::string_view kSpaces = " \t\r";
constexpr std::string_view kSpacesAndQuotes = " \t\r\"";

std::string_view Trimmed(std::string_view text, std::string_view ends = kSpacesAndQuotes) {
  const size_t begin = text.find_first_not_of(ends);
  if (begin == std::string_view::npos) return {};
  return text.substr(begin, text.find_last_not_of(ends) - begin + 1);
}

std::optional<double> Number(std::string_view text) {
  double value = 0;
  if (ParseNumber(text, &value) != std::errc()) return std::nullopt;
  if (!std::isfinite(value) || std::abs(value) > kMaxAngleDeg) return std::nullopt;
  return value;
}

// A number that has a decimal comma, with a point instead; nothing when the text is none.
std::optional<std::string> WithDecimalPoint(std::string_view text) {
  const size_t comma = text.find(',');
  if (comma == std::string_view::npos) return std::nullopt;
  std::string number(text);
  number[comma] = '.';
  if (!Number(number)) return std::nullopt;
  return number;
}

// Calls use(number, line) with the lines that are neither empty nor comments, and their numbers from 1 on.
template <typename Use>
void ForEachLine(std::string_view text, const Use& use) {
  for (size_t number = 1; !text.empty(); ++number) {
    const size_t end = std::min(text.find('\n'), text.size());
    const std::string_view whole = text.substr(0, end);
    text.remove_prefix(std::min(end + 1, text.size()));
    const std::string_view line = Trimmed(whole);
    if (line.empty() || line[0] == '#') continue;
    // Some programs put a line as a whole into quotes: those are around no cell.
    const bool has_quoted_cells = line.find('"') != std::string_view::npos;
    use(number, has_quoted_cells ? Trimmed(whole, kSpaces) : line);
  }
}

// Where a line's last separator stands that is not within double quotes; npos for none.
size_t FindSplit(std::string_view line, char separator) {
  size_t split = std::string_view::npos;
  bool is_quoted = false;
  bool may_open = true;  // where a cell begins; after a quote, too, for two of them are one within a name
  for (size_t i = 0; i < line.size(); ++i) {
    const char c = line[i];
    if (c == '"' && (is_quoted || may_open)) {
      is_quoted = !is_quoted;
      may_open = true;
    } else if (!is_quoted) {
      if (c == separator) split = i;
      may_open = c == ',' || c == ';' || c == '\t' || (may_open && c == ' ');
    }
  }
  return split;
}

// One for all lines: where numbers have decimal commas, commas separate nothing.
char SeparatorOf(std::string_view text) {
  for (const char separator : {'\t', ';'}) {
    bool is_there = false;
    ForEachLine(text, [&](size_t /*number*/, std::string_view line) {
      is_there = is_there || FindSplit(line, separator) != std::string_view::npos;
    });
    if (is_there) return separator;
  }
  return ',';
}

// OpenScan's photos of the folder's own scan or, a level down, of a project's scans.
void AddOpenScanAngles(const fs::path& scan, const std::string& prefix,
                       std::map<std::string, double>* angles) {
  std::error_code ec;
  for (const auto& entry : fs::directory_iterator(scan / "metadata", ec)) {
    if (LowerCaseExtension(entry.path()) != ".json") continue;
    const std::string name = prefix + entry.path().stem().string();
    if (const std::optional<std::string> fault = ImageName::FindFault(name)) {
      throw UserError(entry.path(), "the name " + DescribeNameFault(name, *fault), "Rename it as its photo");
    }
    const nlohmann::json json = ReadJsonFile(entry.path());
    const nlohmann::json::json_pointer place("/scan_metadata/polar_coordinates/fi");
    const bool has_angle = json.is_object() && json.contains(place) && json[place].is_number();
    const double angle = has_angle ? json[place].get<double>() : std::nan("");
    if (!(std::abs(angle) <= kMaxAngleDeg)) {
      throw UserError(entry.path(), "holds no scan_metadata.polar_coordinates.fi, the turntable's angle",
                      "Remove it, or give the angles as NAME,ANGLE lines of a file");
    }
    angles->emplace(name, angle);
  }
}

std::map<std::string, double> ReadOpenScanAngles(const fs::path& folder) {
  std::map<std::string, double> angles;
  AddOpenScanAngles(folder, "", &angles);
  std::error_code ec;
  for (const auto& entry : fs::directory_iterator(folder, ec)) {
    if (entry.is_directory(ec))
      AddOpenScanAngles(entry.path(), entry.path().filename().string() + "/", &angles);
  }
  if (angles.empty()) {
    throw UserError(folder, "holds no metadata/NAME.json of OpenScan's photos",
                    "Give that folder, or a file of one NAME,ANGLE a line, in degrees");
  }
  return angles;
}

std::string WithoutExtension(const std::string& name) {
  return fs::path(name).replace_extension().generic_string();
}

}  // namespace

std::map<std::string, double> ParseAngleList(std::string_view text, const fs::path& path) {
  text = WithoutByteOrderMark(text);
  const char separator = SeparatorOf(text);
  std::map<std::string, double> angles;
  bool may_be_heading = true;
  ForEachLine(text, [&](size_t number, std::string_view line) {
    const auto fail = [&](const std::string& problem, const std::string& remedy = kListRemedy) {
      throw UserError(path, "line " + std::to_string(number) + ": " + problem, remedy);
    };
    if (line.size() > kMaxLineLength) fail("the file is no list of angles");
    const size_t split = FindSplit(line, separator);
    if (split == std::string_view::npos && separator == ',') fail("has no comma, semicolon or tab");
    if (split == std::string_view::npos) {
      fail(std::string("has no ") + (separator == ';' ? "semicolon" : "tab") +
           ", which separates name and angle in other lines");
    }
    const std::string name(Trimmed(line.substr(0, split)));
    const std::string_view written = Trimmed(line.substr(split + 1));
    const std::optional<double> angle = Number(written);
    const std::optional<std::string> with_point = WithDecimalPoint(written);
    const bool is_heading = may_be_heading && !angle && !with_point;
    may_be_heading = false;
    if (is_heading) return;
    if (const std::optional<std::string> fault = ImageName::FindFault(name)) {
      fail("the name " + DescribeNameFault(name, *fault));
    }
    if (with_point) fail("the angle of " + name + " has a decimal comma", "Write " + *with_point);
    if (!angle) fail("the angle of " + name + " is no number of degrees");
    if (!angles.emplace(name, *angle).second) fail(name + " stands there twice");
  });
  if (angles.empty()) throw UserError(path, "lists no angles", kListRemedy);
  return angles;
}

std::map<std::string, double> ReadAngleList(const fs::path& path) {
  std::error_code ec;
  if (fs::is_directory(path, ec)) return ReadOpenScanAngles(path);
  return ParseAngleList(ReadWholeFile(path, kMaxListBytes, "Check --angles_path"), path);
}

std::map<std::string, double> AnglesOfPhotos(const std::map<std::string, double>& listed,
                                             const std::vector<std::string>& photos, const fs::path& path,
                                             std::vector<std::string>* unknown) {
  const std::set<std::string> names(photos.begin(), photos.end());
  std::map<std::string, std::vector<std::string>> by_stem;
  for (const std::string& name : photos) by_stem[WithoutExtension(name)].push_back(name);
  std::map<std::string, double> angles;
  for (const auto& [name, angle] : listed) {
    if (names.count(name) > 0) {
      angles[name] = angle;
      continue;
    }
    const auto found = by_stem.find(WithoutExtension(name));
    if (found != by_stem.end() && found->second.size() == 1) {
      angles.emplace(found->second[0], angle);
    } else {
      unknown->push_back(name);
    }
  }
  if (angles.empty()) {
    throw UserError(path, "names none of the photos: " + listed.begin()->first + ", for example",
                    "Give names relative to the photos' folder");
  }
  return angles;
}

}  // namespace s2gs
