#include "sfm_split/scene/io/turntable_file.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <sstream>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/image_name.h"

namespace s2gs {
namespace {

using nlohmann::json;

constexpr int kVersion = 1;             // of the format
constexpr double kMaxDeviation = 1e-6;  // single precision, with room for a few products.
constexpr double kMinTurnDeg = 0.5;     // a judgement: the table of photos without a turn stays within noise
// A judgement: no rounding and no noise; a sign or a unit is wrong.
constexpr double kMaxContradictionDeg = 5;
constexpr size_t kMaxNamedSets = 6;
constexpr uint64_t kMaxFileBytes = uint64_t{1} << 30;  // a million images

// One value of the file and where it is, e.g. "images[3].station".
class Value {
 public:
  Value(const json& value, std::string place, const std::filesystem::path& path)
      : value_(value), place_(std::move(place)), path_(path) {}

  [[noreturn]] void Fail(const std::string& problem) const {
    throw UserError(path_, (place_.empty() ? "the file" : place_) + " " + problem,
                    "Correct the file, or run `s2gs turntable_mapper` to write it again");
  }

  Value operator[](const char* key) const {
    if (!value_.is_object()) Fail("is not an object");
    const auto found = value_.find(key);
    const std::string place = place_.empty() ? key : place_ + "." + key;
    if (found == value_.end()) Value(value_, place, path_).Fail("is missing");
    return Value(*found, place, path_);
  }
  Value At(size_t index) const {
    return Value(value_[index], place_ + "[" + std::to_string(index) + "]", path_);
  }

  size_t ArraySize() const {
    if (!value_.is_array()) Fail("is not a list");
    return value_.size();
  }
  void ExpectArray(size_t size) const {
    if (ArraySize() != size)
      Fail("has " + std::to_string(value_.size()) + " items, not " + std::to_string(size));
  }
  double Number() const {
    if (!value_.is_number()) Fail("is not a number");
    const auto number = value_.get<double>();
    if (!std::isfinite(number)) Fail("is not finite");
    return number;
  }
  int Integer(int min, int max) const {
    const bool fits = value_.is_number_unsigned() ? value_.get<uint64_t>() <= static_cast<uint64_t>(max)
                                                  : value_.is_number_integer();
    if (!fits || value_.get<int64_t>() < min || value_.get<int64_t>() > max) {
      Fail("is not a whole number from " + std::to_string(min) + " to " + std::to_string(max));
    }
    return value_.get<int>();
  }
  bool Boolean() const {
    if (!value_.is_boolean()) Fail("is not true or false");
    return value_.get<bool>();
  }
  std::string Text() const {
    if (!value_.is_string()) Fail("is not a text");
    return value_.get<std::string>();
  }
  Eigen::Vector3d Vector3() const {
    ExpectArray(3);
    return {At(0).Number(), At(1).Number(), At(2).Number()};
  }

 private:
  const json& value_;
  std::string place_;
  const std::filesystem::path& path_;
};

Rigid3 RigidFrom(const Value& value) {
  Eigen::Matrix4d matrix;
  value.ExpectArray(4);
  for (int row = 0; row < 4; ++row) {
    value.At(row).ExpectArray(4);
    for (int col = 0; col < 4; ++col) matrix(row, col) = value.At(row).At(col).Number();
  }
  const Eigen::Matrix3d rotation = matrix.topLeftCorner<3, 3>();
  const Eigen::Matrix3d gram = rotation.transpose() * rotation;
  if ((matrix.row(3) - Eigen::RowVector4d(0, 0, 0, 1)).cwiseAbs().maxCoeff() > kMaxDeviation) {
    value.Fail("is not rigid: its last row is not 0 0 0 1");
  }
  if (!((gram - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff() <= kMaxDeviation)) {
    value.Fail("is not rigid: its rotation part scales or shears");
  }
  if (!(rotation.determinant() > 0)) value.Fail("is not rigid: it mirrors");
  Rigid3 rigid;
  rigid.rotation = Eigen::Quaterniond(rotation).normalized();
  rigid.translation = matrix.topRightCorner<3, 1>();
  return rigid;
}

std::vector<std::vector<int>> TiedStationsFrom(const Value& value, int num_stations) {
  std::vector<std::vector<int>> sets(value.ArraySize());
  std::set<int> seen;
  for (size_t i = 0; i < sets.size(); ++i) {
    const Value stations = value.At(i);
    for (size_t k = 0; k < stations.ArraySize(); ++k) {
      sets[i].push_back(stations.At(k).Integer(0, num_stations - 1));
      if (!seen.insert(sets[i].back()).second) stations.At(k).Fail("occurs twice");
    }
  }
  if (seen.size() != static_cast<size_t>(num_stations)) value.Fail("lacks a station");
  return sets;
}

TurntableFile FromJson(const json& root, const std::filesystem::path& path) {
  const Value file(root, "", path);
  const int version = file["version"].Integer(1, std::numeric_limits<int>::max());
  if (version != kVersion) {
    file["version"].Fail("is " + std::to_string(version) + ", this program reads " +
                         std::to_string(kVersion));
  }
  TurntableFile turntable;
  turntable.axis.point = file["axis"]["point"].Vector3();
  turntable.axis.direction = file["axis"]["direction"].Vector3();
  const double length = turntable.axis.direction.stableNorm();
  if (!(std::abs(length - 1) <= kMaxDeviation)) file["axis"]["direction"].Fail("is not of unit length");
  if (std::abs(length - 1) > 1e-15) turntable.axis.direction /= length;
  turntable.num_stations = file["stations"].Integer(1, std::numeric_limits<int>::max());
  turntable.scale_observable = file["scale_observable"].Boolean();
  const std::string units = file["units"].Text();
  if (units != "sfm" && units != "metre") file["units"].Fail("is neither \"sfm\" nor \"metre\"");
  turntable.units = units == "metre" ? LengthUnit::kMetre : LengthUnit::kSfm;

  if (root.contains("tied_stations"))
    turntable.tied_stations = TiedStationsFrom(file["tied_stations"], turntable.num_stations);

  const Value images = file["images"];
  if (images.ArraySize() == 0) images.Fail("is empty");
  std::set<std::string> names;
  for (size_t i = 0; i < images.ArraySize(); ++i) {
    const Value item = images.At(i);
    TurntableImage image;
    image.name = item["name"].Text();
    if (const std::optional<std::string> fault = ImageName::FindFault(image.name)) {
      item["name"].Fail("is no image's name: " + DescribeNameFault(image.name, *fault));
    }
    if (!names.insert(image.name).second) item["name"].Fail("occurs twice: " + image.name);
    image.station = item["station"].Integer(0, turntable.num_stations - 1);
    image.angle_deg = item["angle_deg"].Number();
    image.world_from_object = RigidFrom(item["object_to_world"]);
    turntable.images.push_back(std::move(image));
  }
  return turntable;
}

json ToJson(const Eigen::Vector3d& v) { return {v.x(), v.y(), v.z()}; }

json ToJson(const TurntableImage& image) {
  const Eigen::Matrix4d matrix = image.world_from_object.Matrix();
  json rows = json::array();
  for (int row = 0; row < 4; ++row) {
    rows.push_back({matrix(row, 0), matrix(row, 1), matrix(row, 2), matrix(row, 3)});
  }
  return {{"name", image.name},
          {"station", image.station},
          {"angle_deg", image.angle_deg},
          {"object_to_world", std::move(rows)}};
}

// One image a line: the file stays readable and small.
std::string ToText(const TurntableFile& turntable) {
  const json axis = {{"point", ToJson(turntable.axis.point)},
                     {"direction", ToJson(turntable.axis.direction)}};
  std::string text = "{\n\"version\": " + std::to_string(kVersion) + ",\n\"axis\": " + axis.dump() +
                     ",\n\"stations\": " + std::to_string(turntable.num_stations) +
                     ",\n\"scale_observable\": " + (turntable.scale_observable ? "true" : "false") +
                     ",\n\"units\": \"" + (turntable.units == LengthUnit::kMetre ? "metre" : "sfm") + "\",\n";
  if (!turntable.tied_stations.empty())
    text += "\"tied_stations\": " + json(turntable.tied_stations).dump() + ",\n";
  text += "\"images\": [";
  for (size_t i = 0; i < turntable.images.size(); ++i) {
    text += (i == 0 ? "\n" : ",\n") + ToJson(turntable.images[i]).dump();
  }
  return text + "\n]\n}\n";
}

}  // namespace

bool TableTurns(const TurntableFile& turntable) {
  if (turntable.images.empty()) return false;
  const Eigen::Quaterniond first = turntable.images.front().world_from_object.rotation;
  return std::any_of(turntable.images.begin(), turntable.images.end(), [&](const TurntableImage& image) {
    return first.angularDistance(image.world_from_object.rotation) > kMinTurnDeg * kPi / 180;
  });
}

std::optional<std::string> FindContradiction(const TurntableFile& turntable) {
  std::map<int, const TurntableImage*> first_of_station;
  size_t count = 0;
  double worst = 0;
  std::string name;
  for (const TurntableImage& image : turntable.images) {
    const TurntableImage& first = *first_of_station.emplace(image.station, &image).first->second;
    // The whole turns that an angle may have count for nothing.
    const double angle = std::remainder(image.angle_deg - first.angle_deg, 360.0) * kPi / 180;
    const Eigen::Quaterniond turn(Eigen::AngleAxisd(angle, turntable.axis.direction));
    const double apart =
        turn.angularDistance(image.world_from_object.rotation * first.world_from_object.rotation.conjugate());
    if (apart <= kMaxContradictionDeg * kPi / 180) continue;
    ++count;
    if (apart > worst) {
      worst = apart;
      name = image.name;
    }
  }
  if (count == 0) return std::nullopt;
  return "the angle_deg of " + std::to_string(count) + " of " + std::to_string(turntable.images.size()) +
         " images contradict their object_to_world, that of " + name + " by " +
         std::to_string(std::lround(worst * 180 / kPi)) + " degrees; the matrices count";
}

std::string DescribeUntiedStations(const std::vector<std::vector<int>>& tied_stations) {
  if (tied_stations.size() < 2) return {};
  std::string sets;
  for (size_t i = 0; i < std::min(tied_stations.size(), kMaxNamedSets); ++i) {
    sets += i == 0 ? "" : " | ";
    for (size_t k = 0; k < tied_stations[i].size(); ++k)
      sets += (k == 0 ? "" : ", ") + std::to_string(tied_stations[i][k]);
  }
  if (tied_stations.size() > kMaxNamedSets) sets += " | ...";
  return "table angles are known within, not between, " + std::to_string(tied_stations.size()) +
         " sets of stations (" + sets + "): nothing that stands still is seen from both";
}

TurntableFile ReadTurntableFile(std::istream& stream, const std::filesystem::path& path) {
  json root;
  try {
    root = json::parse(stream);
  } catch (const json::exception& error) {
    throw UserError(path, std::string("is not JSON (") + error.what() + ")",
                    "Correct the file, or run `s2gs turntable_mapper` to write it again");
  }
  return FromJson(root, path);
}

TurntableFile ReadTurntableFile(const std::filesystem::path& path) {
  std::istringstream stream(ReadWholeFile(
      path, kMaxFileBytes, "Run `s2gs turntable_mapper`, which writes it, or write it from your own rig"));
  return ReadTurntableFile(stream, path);
}

void WriteTurntableFile(std::ostream& stream, const TurntableFile& turntable,
                        const std::filesystem::path& path) {
  std::string text;
  try {
    text = ToText(turntable);
  } catch (const json::exception&) {
    throw UserError(path, "cannot hold the name of an image, because the name is not UTF-8",
                    "Rename the image files");
  }
  std::istringstream check(text);
  ReadTurntableFile(check, path);
  stream << text;
}

void WriteTurntableFile(const std::filesystem::path& path, const TurntableFile& turntable) {
  WriteFileAtomically(path, [&](std::ostream& stream) { WriteTurntableFile(stream, turntable, path); });
}

}  // namespace s2gs
