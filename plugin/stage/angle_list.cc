#include "plugin/stage/angle_list.h"

#include <cmath>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <sstream>
#include <string_view>
#include <system_error>

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

std::string_view Trimmed(std::string_view text) {
  const size_t begin = text.find_first_not_of(" \t\r\"");
  if (begin == std::string_view::npos) return {};
  return text.substr(begin, text.find_last_not_of(" \t\r\"") - begin + 1);
}

std::optional<double> Number(std::string_view text) {
  double value = 0;
  if (ParseNumber(text, &value) != std::errc()) return std::nullopt;
  if (!std::isfinite(value) || std::abs(value) > kMaxAngleDeg) return std::nullopt;
  return value;
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

std::map<std::string, double> ReadAngleList(std::istream& stream, const fs::path& path) {
  const auto fail = [&](size_t line, const std::string& problem) {
    throw UserError(path, "line " + std::to_string(line) + ": " + problem,
                    "Give one NAME,ANGLE a line, in degrees");
  };
  std::map<std::string, double> angles;
  std::string text;
  bool may_be_heading = true;
  for (size_t line = 1; std::getline(stream, text); ++line) {
    if (text.size() > kMaxLineLength) fail(line, "the file is no list of angles");
    const std::string_view content = Trimmed(text);
    if (content.empty() || content[0] == '#') continue;
    const size_t split = content.find_last_of(",;\t");
    if (split == std::string_view::npos) fail(line, "has no comma, semicolon or tab");
    const std::string name(Trimmed(content.substr(0, split)));
    const std::optional<double> angle = Number(Trimmed(content.substr(split + 1)));
    const bool is_heading = may_be_heading && !angle;
    may_be_heading = false;
    if (is_heading) continue;
    if (const std::optional<std::string> fault = ImageName::FindFault(name)) {
      fail(line, "the name " + DescribeNameFault(name, *fault));
    }
    if (!angle) fail(line, "the angle of " + name + " is no number of degrees");
    if (!angles.emplace(name, *angle).second) fail(line, name + " stands there twice");
  }
  if (angles.empty()) throw UserError(path, "lists no angles", "Give one NAME,ANGLE a line, in degrees");
  return angles;
}

std::map<std::string, double> ReadAngleList(const fs::path& path) {
  std::error_code ec;
  if (fs::is_directory(path, ec)) return ReadOpenScanAngles(path);
  std::istringstream stream(ReadWholeFile(path, kMaxListBytes, "Check --angles_path"));
  return ReadAngleList(stream, path);
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
