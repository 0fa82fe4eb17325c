#include "plugin/report/report_input.h"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <limits>
#include <set>
#include <system_error>

#include "plugin/stage/json_file.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/lower_case.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

constexpr uint64_t kMaxJsonBytes = uint64_t{1} << 30;

std::vector<Json> ReadLog(const fs::path& path) {
  std::vector<Json> lines;
  std::ifstream log(path);
  std::string line;
  while (std::getline(log, line)) {
    Json entry = Json::parse(line, nullptr, false);
    if (entry.is_object()) lines.push_back(std::move(entry));
  }
  return lines;
}

bool IsPhoto(const fs::path& path) {
  const std::string extension = LowerCaseExtension(path);
  return extension == ".jpg" || extension == ".jpeg" || extension == ".png";
}

void ListPhotos(const fs::path& folder, std::set<std::string>* names) {
  std::error_code ec;
  fs::recursive_directory_iterator entry(folder, fs::directory_options::skip_permission_denied, ec);
  for (const fs::recursive_directory_iterator end; !ec && entry != end; entry.increment(ec)) {
    std::error_code file_ec;
    if (entry->is_regular_file(file_ec) && IsPhoto(entry->path())) {
      names->insert(entry->path().lexically_relative(folder).generic_string());
    }
  }
}

// The first folder that holds one of the photos.
fs::path FindPhotos(const ReportInput& input) {
  std::vector<fs::path> folders = {input.workspace.Images()};
  for (const StageStatus& stage : input.stages) {
    if (!stage.stamp) continue;
    for (const StampedPath& path : stage.stamp->inputs) folders.push_back(input.workspace.root / path.path);
  }
  folders.push_back(input.workspace.DenseImages());
  std::error_code ec;
  for (const fs::path& folder : folders) {
    if (!fs::is_directory(folder, ec)) continue;
    for (const std::string& name : input.photos) {
      if (fs::is_regular_file(folder / name, ec)) return folder;
    }
  }
  return {};
}

}  // namespace

int ReportInput::StationOf(const std::string& photo) const {
  if (const TurntableImage* image = TableImage(photo)) return image->station;
  if (!split) return -1;
  const auto found = split->images.find(photo);
  return found == split->images.end() ? -1 : found->second.station;
}

bool ReportInput::ShowsATurn() const {
  return turntable && std::any_of(turntable->images.begin(), turntable->images.end(),
                                  [](const TurntableImage& image) { return image.angle_deg != 0; });
}

Eigen::Vector3d ReportInput::Up() const {
  if (!turntable) return Eigen::Vector3d::UnitZ();
  Eigen::Vector3d axis = turntable->axis.direction.normalized();
  if (ShowsATurn()) return axis;
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  double count = 0;
  for (const TurntableImage& image : turntable->images) {
    const ColmapImage* pose = ObjectImage(image.name);
    if (pose == nullptr) continue;
    // Cameras have y downwards.
    sum -= image.world_from_object.rotation *
           (pose->cam_from_world.rotation.conjugate() * Eigen::Vector3d::UnitY());
    count += 1;
  }
  // The sum of unit vectors in directions of chance has a root mean square of sqrt(count), twice of which one
  // set in a hundred passes.
  if (sum.norm() > 2 * std::sqrt(count)) axis = sum.normalized();
  return axis;
}

const char* ReportInput::LengthUnitName() const {
  return turntable && turntable->units == LengthUnit::kMetre ? "m" : "units";
}

const ColmapImage* ReportInput::ObjectImage(const std::string& photo) const {
  const auto found = object_ids.find(photo);
  return found == object_ids.end() ? nullptr : &object->images.at(found->second);
}

const ColmapImage* ReportInput::BackgroundImage(const std::string& photo) const {
  const auto found = background_ids.find(photo);
  return found == background_ids.end() ? nullptr : &background->images.at(found->second);
}

const TurntableImage* ReportInput::TableImage(const std::string& photo) const {
  const auto found = table_rows.find(photo);
  return found == table_rows.end() ? nullptr : &turntable->images[found->second];
}

ReportInput ReadReportInput(const Workspace& workspace, const fs::path& image_path, Reporter& reporter) {
  ReportInput input;
  input.workspace = workspace;
  const auto read = [&](const fs::path& path, const std::function<void()>& fill) {
    if (!Exists(path)) return;
    try {
      fill();
    } catch (const UserError& error) {
      input.problems.emplace_back(error.what());
      reporter.Warn(std::string("the report leaves out what cannot be read: ") + error.what());
    }
  };
  read(workspace.ObjectModel(), [&] { input.object = ReadColmapModel(workspace.ObjectModel()); });
  read(workspace.StaticModel(), [&] { input.background = ReadColmapModel(workspace.StaticModel()); });
  read(workspace.Turntable(), [&] { input.turntable = ReadTurntableFile(workspace.Turntable()); });
  read(workspace.SplitLabels(), [&] {
    input.split =
        ParseSplitLabels(ReadWholeFile(workspace.SplitLabels(), kMaxJsonBytes), workspace.SplitLabels());
  });
  input.mapper = ReadJsonFile(workspace.TurntableMapper());
  if (!input.mapper.is_object()) input.mapper = nullptr;
  input.log = ReadLog(workspace.Log());
  for (const fs::path& log : {workspace.MaskLog(), workspace.MeshLog()}) {
    for (Json& line : ReadLog(log)) input.log.push_back(std::move(line));
  }
  input.stages = CheckStages(workspace, reporter);

  std::set<std::string> names;
  if (input.object) {
    for (const auto& [id, image] : input.object->images) {
      input.object_ids[image.name] = id;
      names.insert(image.name);
    }
  }
  if (input.background) {
    for (const auto& [id, image] : input.background->images) input.background_ids[image.name] = id;
  }
  if (input.turntable) {
    for (size_t i = 0; i < input.turntable->images.size(); ++i) {
      input.table_rows[input.turntable->images[i].name] = i;
      names.insert(input.turntable->images[i].name);
    }
  }
  if (input.split) {
    for (const auto& [name, image] : input.split->images) names.insert(name);
  }
  if (names.empty()) ListPhotos(image_path.empty() ? workspace.Images() : image_path, &names);
  input.photos.assign(names.begin(), names.end());
  input.image_path = image_path.empty() ? FindPhotos(input) : image_path;
  return input;
}

nlohmann::ordered_json FiniteOrNull(double value) {
  if (!std::isfinite(value)) return nullptr;
  return value;
}

double NumberOr(const Json& object, const std::string& key) {
  if (!object.is_object()) return std::numeric_limits<double>::quiet_NaN();
  const auto found = object.find(key);
  if (found == object.end() || !found->is_number()) return std::numeric_limits<double>::quiet_NaN();
  return found->get<double>();
}

std::string Count(size_t count, const std::string& what) {
  return std::to_string(count) + " " + what + (count == 1 ? "" : "s");
}

}  // namespace s2gs
