#include <cmath>
#include <set>
#include <string_view>

#include "sfm_split/base/error.h"
#include "sfm_split/base/image_name.h"
#include "sfm_split/scene/camera_check.h"
#include "sfm_split/scene/io/colmap_model_files.h"

namespace s2gs {
namespace {

constexpr double kMaxDistance = 1e12;  // of a camera, in any unit; beyond, the digits of a scene are lost

std::string Name(const char* kind, uint64_t id) { return std::string(kind) + " " + std::to_string(id); }

// For messages: which file of a model says so.
class Faults {
 public:
  Faults(const std::filesystem::path& folder, ColmapFormat format)
      : folder_(folder), extension_(format == ColmapFormat::kBinary ? ".bin" : ".txt") {}

  [[noreturn]] void Throw(const char* file, const std::string& problem) const {
    throw UserError(
        folder_ / (file + extension_), problem,
        "The files of this model do not belong together or are damaged: write the model again with "
        "the program that made it");
  }

  template <typename Id, typename Item>
  void ThrowUnlessSound(const char* file, const std::map<Id, Item>& items) const {
    for (const auto& [id, item] : items) {
      if (const std::optional<std::string> fault = FindFault(item)) Throw(file, *fault);
    }
  }

 private:
  std::filesystem::path folder_;
  std::string extension_;
};

void CheckImages(const ColmapModel& model, const Faults& faults) {
  std::set<std::string_view> names;
  for (const auto& [id, image] : model.images) {
    S2GS_INVARIANT(id == image.image_id);
    if (model.cameras.count(image.camera_id) == 0) {
      faults.Throw("images", Name("image", id) + " was taken by " + Name("camera", image.camera_id) +
                                 ", which does not exist");
    }
    if (!names.insert(image.name).second) {
      faults.Throw("images", "two images have the name " + image.name);
    }
  }
}

// Every observation of a point by an image must be known to the other side. When each track element finds its
// keypoint and there are as many elements as keypoints with a point, nothing is left over.
void CheckTracks(const ColmapModel& model, const Faults& faults) {
  uint64_t num_elements = 0;
  for (const auto& [id, point] : model.points3D) {
    S2GS_INVARIANT(id == point.point3D_id);
    for (const ColmapTrackElement& element : point.track) {
      const auto image = model.images.find(element.image_id);
      if (image == model.images.end()) {
        faults.Throw("points3D", Name("point", id) + " is seen by " + Name("image", element.image_id) +
                                     ", which does not exist");
      }
      if (element.point2D_idx >= image->second.points2D.size()) {
        faults.Throw("points3D", Name("point", id) + " is seen at " + Name("keypoint", element.point2D_idx) +
                                     " of " + Name("image", element.image_id) + ", which has " +
                                     std::to_string(image->second.points2D.size()));
      }
      if (image->second.points2D[element.point2D_idx].point3D_id != id) {
        faults.Throw("points3D", Name("point", id) + " is seen at " + Name("keypoint", element.point2D_idx) +
                                     " of " + Name("image", element.image_id) +
                                     ", which the image does not confirm");
      }
    }
    num_elements += point.track.size();
  }
  uint64_t num_observations = 0;
  for (const auto& [id, image] : model.images) {
    for (const ColmapPoint2D& keypoint : image.points2D) {
      if (keypoint.point3D_id == kInvalidPoint3DId) continue;
      ++num_observations;
      if (model.points3D.count(keypoint.point3D_id) == 0) {
        faults.Throw("images", Name("image", id) + " sees " + Name("point", keypoint.point3D_id) +
                                   ", which does not exist");
      }
    }
  }
  if (num_observations != num_elements) {
    faults.Throw("points3D", "the tracks have " + std::to_string(num_elements) +
                                 " elements, but the images " + std::to_string(num_observations) +
                                 " keypoints with a point");
  }
}

bool HasSensor(const ColmapRig& rig, const ColmapSensor& sensor) {
  const auto is_it = [&](const ColmapSensor& other) {
    return other.type == sensor.type && other.id == sensor.id;
  };
  if (rig.ref_sensor && is_it(*rig.ref_sensor)) return true;
  for (const ColmapRigSensor& other : rig.sensors) {
    if (is_it(other.sensor)) return true;
  }
  return false;
}

void CheckRigs(const ColmapModel& model, const Faults& faults) {
  for (const auto& [id, rig] : model.rigs) {
    S2GS_INVARIANT(id == rig.rig_id);
    const auto check = [&, rig_id = id](const ColmapSensor& sensor) {
      if (sensor.type == ColmapSensorType::kCamera && model.cameras.count(sensor.id) == 0) {
        faults.Throw("rigs",
                     Name("rig", rig_id) + " has " + Name("camera", sensor.id) + ", which does not exist");
      }
    };
    if (rig.ref_sensor) check(*rig.ref_sensor);
    for (const ColmapRigSensor& sensor : rig.sensors) check(sensor.sensor);
  }
}

void CheckFrames(const ColmapModel& model, const Faults& faults) {
  std::set<uint64_t> images_in_frames;
  for (const auto& [id, frame] : model.frames) {
    S2GS_INVARIANT(id == frame.frame_id);
    const auto rig = model.rigs.find(frame.rig_id);
    if (rig == model.rigs.end()) {
      faults.Throw("frames",
                   Name("frame", id) + " belongs to " + Name("rig", frame.rig_id) + ", which does not exist");
    }
    for (const ColmapFrameData& data : frame.data) {
      if (!HasSensor(rig->second, data.sensor)) {
        faults.Throw("frames", Name("frame", id) + " uses " + Name("sensor", data.sensor.id) + ", which " +
                                   Name("rig", frame.rig_id) + " does not have");
      }
      if (data.sensor.type != ColmapSensorType::kCamera) continue;
      if (!images_in_frames.insert(data.data_id).second) {
        faults.Throw("frames", Name("image", data.data_id) + " occurs in two frames");
      }
      const auto image = model.images.find(static_cast<uint32_t>(data.data_id));
      if (data.data_id > std::numeric_limits<uint32_t>::max() || image == model.images.end()) {
        faults.Throw("frames",
                     Name("frame", id) + " holds " + Name("image", data.data_id) + ", which does not exist");
      }
      if (image->second.camera_id != data.sensor.id) {
        faults.Throw("frames", Name("frame", id) + " says that " + Name("image", data.data_id) +
                                   " was taken by " + Name("camera", data.sensor.id) + ", the image says " +
                                   Name("camera", image->second.camera_id));
      }
    }
  }
  if (images_in_frames.size() == model.images.size() || (model.rigs.empty() && model.frames.empty())) return;
  for (const auto& [id, image] : model.images) {
    if (images_in_frames.count(id) == 0) faults.Throw("frames", Name("image", id) + " is in no frame");
  }
}

}  // namespace

std::optional<std::string> FindFault(const Camera& camera) {
  const std::string name = Name("camera", camera.camera_id);
  if (const std::optional<std::string> fault = FindCameraFault(camera)) return name + " " + *fault;
  return std::nullopt;
}

std::optional<std::string> FindFault(const ColmapImage& image) {
  const std::string name = Name("image", image.image_id);
  if (const std::optional<std::string> fault = ImageName::FindFault(image.name)) {
    return "the name of " + name + ", " + DescribeNameFault(image.name, *fault);
  }
  if (!image.cam_from_world.translation.allFinite() || !image.cam_from_world.rotation.coeffs().allFinite()) {
    return name + " has a pose that is not finite";
  }
  if (!(image.cam_from_world.translation.cwiseAbs().maxCoeff() <= kMaxDistance)) {
    return name + " has a pose further than 1e12 from the origin";
  }
  for (const ColmapPoint2D& point : image.points2D) {
    if (!point.xy.allFinite()) return name + " has a keypoint that is not finite";
  }
  return std::nullopt;
}

std::optional<std::string> FindFault(const ColmapPoint3D& point) {
  const std::string name = Name("point", point.point3D_id);
  if (point.point3D_id == kInvalidPoint3DId) return name + " has the id that means no point";
  if (!point.xyz.allFinite()) return name + " has a position that is not finite";
  return std::nullopt;
}

std::optional<std::string> FindFault(const ColmapRig& rig) {
  const std::string name = Name("rig", rig.rig_id);
  if (!rig.ref_sensor && !rig.sensors.empty()) return name + " has sensors but no reference sensor";
  std::set<std::pair<int, uint32_t>> sensors;
  if (rig.ref_sensor) sensors.emplace(static_cast<int>(rig.ref_sensor->type), rig.ref_sensor->id);
  for (const ColmapRigSensor& sensor : rig.sensors) {
    if (!sensors.emplace(static_cast<int>(sensor.sensor.type), sensor.sensor.id).second) {
      return name + " has " + Name("sensor", sensor.sensor.id) + " twice";
    }
  }
  return std::nullopt;
}

std::optional<std::string> FindFault(const ColmapFrame& frame) {
  if (!frame.rig_from_world.translation.allFinite() || !frame.rig_from_world.rotation.coeffs().allFinite()) {
    return Name("frame", frame.frame_id) + " has a pose that is not finite";
  }
  return std::nullopt;
}

std::optional<Rigid3> PoseFromNumbers(const Eigen::Matrix<double, 7, 1>& qwxyz_t) {
  // A unit quaternion's own: nothing changes when it is written and read again.
  constexpr double kRounding = 1e-12;
  constexpr double kMinNorm = 1e-6;  // shorter is no quaternion that rounding explains
  if (!qwxyz_t.allFinite()) return std::nullopt;
  Rigid3 pose;
  pose.rotation = Eigen::Quaterniond(qwxyz_t[0], qwxyz_t[1], qwxyz_t[2], qwxyz_t[3]);
  pose.translation = qwxyz_t.tail<3>();
  const double norm = pose.rotation.coeffs().stableNorm();
  if (!(norm >= kMinNorm) || !std::isfinite(norm)) return std::nullopt;
  if (std::abs(norm - 1) > kRounding) pose.rotation.coeffs() /= norm;
  return pose;
}

Eigen::Matrix<double, 7, 1> NumbersFromPose(const Rigid3& pose) {
  Eigen::Matrix<double, 7, 1> numbers;
  numbers << pose.rotation.w(), pose.rotation.x(), pose.rotation.y(), pose.rotation.z(), pose.translation;
  return numbers;
}

void CheckColmapModel(const ColmapModel& model, const std::filesystem::path& folder, ColmapFormat format) {
  const Faults faults(folder, format);
  faults.ThrowUnlessSound("cameras", model.cameras);
  faults.ThrowUnlessSound("images", model.images);
  faults.ThrowUnlessSound("points3D", model.points3D);
  faults.ThrowUnlessSound("rigs", model.rigs);
  faults.ThrowUnlessSound("frames", model.frames);
  for (const auto& [id, camera] : model.cameras) S2GS_INVARIANT(id == camera.camera_id);
  CheckImages(model, faults);
  CheckTracks(model, faults);
  CheckRigs(model, faults);
  CheckFrames(model, faults);
}

}  // namespace s2gs
