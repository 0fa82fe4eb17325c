#include "sfm_split/scene/scene_truth.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <sstream>
#include <utility>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/image_name.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

constexpr uint64_t kMaxFileBytes = uint64_t{1} << 28;  // some 100,000 images
// Of every fault.
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
  std::string file = entry.String();
  if (const std::optional<std::string> fault = ImageName::FindFault(file)) {
    entry.Fail("is not a file below the data set's folder: " + DescribeNameFault(file, *fault));
  }
  return file;
}

// The parameters after focal lengths and principal point, by COLMAP's names ("k, p1"); a model's only "k" may
// be called k1.
std::vector<double> ExtraParams(const Entry& root, const CameraModelInfo& info) {
  std::vector<double> params;
  params.reserve(info.num_extra_params);
  std::istringstream names{std::string(info.param_names)};
  std::string name;
  for (size_t i = 0; names >> name; ++i) {
    if (i < info.FirstExtraParam()) continue;
    if (name.back() == ',') name.pop_back();
    const bool is_numbered = name == "k" && !root.Has("k") && root.Has("k1");
    params.push_back(root.At(is_numbered ? "k1" : name.c_str()).Number());
  }
  return params;
}

Camera ReadCamera(const Entry& root) {
  Camera camera;
  const std::string model = root.At("camera_model").String();
  const CameraModelInfo* info = FindCameraModel(model);
  if (info == nullptr || !info->has_projection) {
    root.At("camera_model").Fail("is \"" + model + "\", a camera model that cannot be projected here");
  }
  // An image whose pixel centres are counted at whole numbers is off by half a pixel; only the file can tell.
  const Entry convention = root.At("pixel_convention");
  if (convention.String().rfind("COLMAP", 0) != 0) {
    convention.Fail("does not begin with \"COLMAP\" (centre of the top-left pixel at 0.5, 0.5)");
  }
  camera.model = info->id == CameraModelId::kSimplePinhole ? CameraModelId::kPinhole : info->id;
  camera.width = static_cast<uint64_t>(root.At("width").Integer(1, 1 << 20));
  camera.height = static_cast<uint64_t>(root.At("height").Integer(1, 1 << 20));
  const double fx = root.At("fx").Number();
  const double fy = root.At("fy").Number();
  if (!(fx > 0)) root.At("fx").Fail("is not positive");
  if (!(fy > 0)) root.At("fy").Fail("is not positive");
  camera.params = {fx};
  if (InfoOf(camera.model).num_focal_params == 2) {
    camera.params.push_back(fy);
  } else if (fx != fy) {
    root.At("fy").Fail("is not fx, though " + model + " has one focal length");
  }
  camera.params.push_back(root.At("cx").Number());
  camera.params.push_back(root.At("cy").Number());
  const std::vector<double> extra = ExtraParams(root, *info);
  camera.params.insert(camera.params.end(), extra.begin(), extra.end());
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

// How far a motion is from the turn by so many degrees about the axis.
struct TurnError {
  double radians = 0;
  double length = 0;
};

TurnError CompareWithTurn(const Rigid3& motion, double angle_deg, const TurntableAxis& axis) {
  const Eigen::Quaterniond turn(Eigen::AngleAxisd(angle_deg * kDegree, axis.direction));
  return {turn.angularDistance(motion.rotation), (motion * axis.point - axis.point).norm()};
}

bool IsTurn(const Rigid3& motion, double angle_deg, const TurntableAxis& axis) {
  const TurnError error = CompareWithTurn(motion, angle_deg, axis);
  const double lengths = axis.point.norm() + motion.translation.norm() + 1e-3;
  return error.radians <= kAngleToleranceDeg * kDegree && error.length <= 1e-5 * lengths;
}

SceneTruthImage ReadTruthImage(const Entry& entry) {
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
  return image;
}

}  // namespace

bool SceneTruth::AxisIsFixedInObject() const {
  return std::all_of(images.begin(), images.end(), [&](const SceneTruthImage& image) {
    return IsTurn(image.world_from_object, image.angle_deg, axis);
  });
}

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
  std::map<int, size_t> first_of_station;
  truth.images.reserve(count);
  for (size_t i = 0; i < count; ++i) {
    truth.images.push_back(ReadTruthImage(images.At(i)));
    const SceneTruthImage& image = truth.images.back();
    // Between stations the object may have been laid down in another way.
    const SceneTruthImage& first = truth.images[first_of_station.emplace(image.station, i).first->second];
    if (!IsTurn(image.world_from_object * first.world_from_object.Inverse(),
                image.angle_deg - first.angle_deg, truth.axis)) {
      images.At(i).Fail("has an object_to_world that is not turned against that of " + first.name +
                        ", of the same station, by their angle_deg about the scene's axis");
    }
    if (!names.insert(image.name).second) {
      images.At(i).Fail("has the file name of an earlier image, " + image.name);
    }
  }
  return truth;
}

}  // namespace s2gs
