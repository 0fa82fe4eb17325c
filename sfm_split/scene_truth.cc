#include "sfm_split/scene_truth.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <cmath>
#include <nlohmann/json.hpp>
#include <set>

#include "sfm_split/error.h"
#include "sfm_split/file_io.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

constexpr uint64_t kMaxFileBytes = uint64_t{1} << 28;
constexpr const char* kRemedy =
    "The file must describe a data set with ground truth: check that it is gt/scene.json";

// Matrices stored with six digits are still rigid to this.
constexpr double kRigidTolerance = 1e-5;
// The most by which an image's turn may differ from its angle_deg, and its axis from the scene's.
constexpr double kAngleToleranceDeg = 1e-3;
constexpr double kLargestLength = 1e12;

// A JSON value together with where it stands in the file.
class Entry {
 public:
  Entry(const Json& value, const fs::path& path, std::string where)
      : value_(value), path_(path), where_(std::move(where)) {}

  [[noreturn]] void Fail(const std::string& problem) const {
    throw UserError(path_, (where_.empty() ? "the file" : "entry " + where_) + " " + problem, kRemedy);
  }

  bool Has(const char* key) const { return value_.is_object() && value_.contains(key); }

  Entry At(const char* key) const {
    if (!value_.is_object()) Fail("is not an object");
    const auto found = value_.find(key);
    if (found == value_.end()) Fail("has no \"" + std::string(key) + "\"");
    return {*found, path_, where_.empty() ? key : where_ + "." + key};
  }

  Entry At(size_t index) const { return {value_[index], path_, where_ + "[" + std::to_string(index) + "]"}; }

  size_t ArraySize() const {
    if (!value_.is_array()) Fail("is not a list");
    return value_.size();
  }

  double Number() const {
    if (!value_.is_number()) Fail("is not a number");
    const auto number = value_.get<double>();
    if (!std::isfinite(number) || std::abs(number) > kLargestLength) Fail("is out of range");
    return number;
  }

  int Integer(int min, int max) const {
    const double number = Number();
    if (number != std::floor(number) || number < min || number > max) {
      Fail("is not a whole number from " + std::to_string(min) + " to " + std::to_string(max));
    }
    return static_cast<int>(number);
  }

  std::string String() const {
    if (!value_.is_string()) Fail("is not a string");
    return value_.get<std::string>();
  }

  Eigen::Vector3d Vector() const {
    if (ArraySize() != 3) Fail("does not have 3 numbers");
    return {At(size_t{0}).Number(), At(size_t{1}).Number(), At(size_t{2}).Number()};
  }

  /// A 4 x 4 row-major matrix that must be rigid.
  Rigid3 Rigid() const {
    Eigen::Matrix4d m;
    if (ArraySize() != 4) Fail("does not have 4 rows");
    for (size_t row = 0; row < 4; ++row) {
      const Entry entries = At(row);
      if (entries.ArraySize() != 4) entries.Fail("does not have 4 numbers");
      for (size_t col = 0; col < 4; ++col) {
        m(static_cast<int>(row), static_cast<int>(col)) = entries.At(col).Number();
      }
    }
    const Eigen::Matrix3d r = m.topLeftCorner<3, 3>();
    if ((m.row(3) - Eigen::RowVector4d(0, 0, 0, 1)).cwiseAbs().maxCoeff() > 0) {
      Fail("does not end in the row 0 0 0 1");
    }
    const bool is_orthonormal =
        (r * r.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff() < kRigidTolerance;
    if (!is_orthonormal || r.determinant() < 0) Fail("is not a rotation and a translation");
    return {Eigen::Quaterniond(r).normalized(), m.topRightCorner<3, 1>()};
  }

 private:
  const Json& value_;
  const fs::path& path_;
  std::string where_;
};

std::string FileName(const Entry& entry) {
  const fs::path file = entry.String();
  if (file.is_absolute() || file.filename().empty()) entry.Fail("is not a file below the data set's folder");
  for (const fs::path& part : file) {
    if (part == "..") entry.Fail("is not a file below the data set's folder");
  }
  return file.string();
}

Camera ReadCamera(const Entry& root) {
  Camera camera;
  const std::string model = root.At("camera_model").String();
  if (model != "SIMPLE_PINHOLE" && model != "PINHOLE") {
    root.At("camera_model").Fail("is \"" + model + "\", not SIMPLE_PINHOLE or PINHOLE");
  }
  // An image whose pixel centres are counted at whole numbers is off by half a pixel; only the file can tell.
  const Entry convention = root.At("pixel_convention");
  if (convention.String().rfind("COLMAP", 0) != 0) {
    convention.Fail("does not begin with \"COLMAP\" (centre of the top-left pixel at 0.5, 0.5)");
  }
  camera.model = CameraModelId::kPinhole;
  camera.width = static_cast<uint64_t>(root.At("width").Integer(1, 1 << 20));
  camera.height = static_cast<uint64_t>(root.At("height").Integer(1, 1 << 20));
  camera.params = {root.At("fx").Number(), root.At("fy").Number(), root.At("cx").Number(),
                   root.At("cy").Number()};
  if (!(camera.params[0] > 0)) root.At("fx").Fail("is not positive");
  if (!(camera.params[1] > 0)) root.At("fy").Fail("is not positive");
  return camera;
}

TurntableAxis ReadAxis(const Entry& root) {
  TurntableAxis axis;
  axis.point = root.At("axis_point").Vector();
  axis.direction = root.At("axis_direction").Vector();
  if (!(axis.direction.norm() > 1e-6)) root.At("axis_direction").Fail("has no length");
  axis.direction.normalize();
  return axis;
}

void CheckTurn(const SceneTruthImage& image, const TurntableAxis& axis, const Entry& entry) {
  const double radians = image.angle_deg * 3.14159265358979323846 / 180;
  const Eigen::Quaterniond turn(Eigen::AngleAxisd(radians, axis.direction));
  const double difference = turn.angularDistance(image.world_from_object.rotation);
  const double moved = (image.world_from_object * axis.point - axis.point).norm();
  const double lengths = axis.point.norm() + image.world_from_object.translation.norm() + 1e-3;
  if (difference > kAngleToleranceDeg * 3.14159265358979323846 / 180 || moved > 1e-5 * lengths) {
    entry.Fail("has an object_to_world that is not the turn by its angle_deg about the scene's axis");
  }
}

SceneTruthImage ReadTruthImage(const Entry& entry, const TurntableAxis& axis) {
  SceneTruthImage image;
  image.file = FileName(entry.At("file"));
  image.name = fs::path(image.file).filename().string();
  if (entry.Has("mask")) image.mask = FileName(entry.At("mask"));
  const std::string split = entry.At("split").String();
  if (split != "train" && split != "test") entry.At("split").Fail("is neither \"train\" nor \"test\"");
  image.is_train = split == "train";
  image.station = entry.At("station").Integer(0, 1 << 20);
  image.angle_deg = entry.At("angle_deg").Number();
  image.cam_from_world = entry.At("world_to_camera").Rigid();
  image.world_from_object = entry.At("object_to_world").Rigid();
  CheckTurn(image, axis, entry);
  return image;
}

}  // namespace

SceneTruth ReadSceneTruth(const fs::path& scene_folder) {
  const fs::path path = scene_folder / "gt" / "scene.json";
  return ParseSceneTruth(ReadWholeFile(path, kMaxFileBytes, kRemedy), path);
}

SceneTruth ParseSceneTruth(std::string_view json, const fs::path& path) {
  Json document;
  try {
    document = Json::parse(json);
  } catch (const Json::exception& error) {
    throw UserError(path, std::string("is not valid JSON (") + error.what() + ")", kRemedy);
  }
  const Entry root(document, path, "");
  SceneTruth truth;
  truth.folder = path.parent_path().parent_path();
  truth.scene = root.At("scene").String();
  truth.units = root.At("units").String();
  truth.camera = ReadCamera(root);
  truth.axis = ReadAxis(root);
  const Entry labels = root.At("mask_values");
  truth.object_label = static_cast<uint8_t>(labels.At("object").Integer(0, 255));
  truth.disc_label = static_cast<uint8_t>(labels.At("disc").Integer(0, 255));
  truth.static_label = static_cast<uint8_t>(labels.At("static").Integer(0, 255));
  if (std::set<int>{truth.object_label, truth.disc_label, truth.static_label}.size() != 3) {
    labels.Fail("gives two things the same value");
  }

  const Entry images = root.At("images");
  const size_t count = images.ArraySize();
  if (count == 0) images.Fail("is empty");
  std::set<std::string> names;
  truth.images.reserve(count);
  for (size_t i = 0; i < count; ++i) {
    truth.images.push_back(ReadTruthImage(images.At(i), truth.axis));
    if (!names.insert(truth.images.back().name).second) {
      images.At(i).Fail("has the file name of an earlier image, " + truth.images.back().name);
    }
  }
  return truth;
}

}  // namespace s2gs
