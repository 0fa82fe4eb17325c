#include "sfm_split/scene/io/colmap_model.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <system_error>
#include <utility>

#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/scene/io/colmap_model_files.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

// Of every version of COLMAP.
constexpr const char* kAllFiles[] = {"cameras", "images", "points3D", "rigs", "frames"};

const char* Extension(ColmapFormat format) { return format == ColmapFormat::kBinary ? ".bin" : ".txt"; }

fs::path FilePath(const fs::path& folder, const char* name, ColmapFormat format) {
  return folder / (std::string(name) + Extension(format));
}

ColmapFormat FormatOf(const fs::path& path) {
  if (path.extension() == ".bin") return ColmapFormat::kBinary;
  if (path.extension() == ".txt") return ColmapFormat::kText;
  throw UserError(path, "is neither a .bin nor a .txt file", "Name a file of a COLMAP model");
}

// Chooses the format in whose files a folder holds a model.
ColmapFormat FormatIn(const fs::path& folder) {
  // Where a folder holds no model.
  constexpr const char* kRemedy =
      "Give the folder of a COLMAP model (sparse/0), or run `colmap mapper` first";
  std::error_code ec;
  if (!fs::is_directory(folder, ec)) throw UserError(folder, "no such folder", kRemedy);
  std::string missing;
  for (const ColmapFormat format : {ColmapFormat::kBinary, ColmapFormat::kText}) {
    int num_found = 0;
    for (const char* name : {"cameras", "images", "points3D"}) {
      if (Exists(FilePath(folder, name, format))) {
        ++num_found;
      } else {
        missing += (missing.empty() ? "" : ", ") + std::string(name) + Extension(format);
      }
    }
    if (num_found == 3) return format;
  }
  throw UserError(folder, "holds no complete COLMAP model (not there: " + missing + ")", kRemedy);
}

std::optional<Rigid3> SensorFromRig(const ColmapRig& rig, const ColmapSensor& sensor) {
  if (rig.ref_sensor && rig.ref_sensor->type == sensor.type && rig.ref_sensor->id == sensor.id) {
    return Rigid3();
  }
  for (const ColmapRigSensor& other : rig.sensors) {
    if (other.sensor.type == sensor.type && other.sensor.id == sensor.id) return other.sensor_from_rig;
  }
  return std::nullopt;
}

bool IsRefSensor(const ColmapRig& rig, const ColmapSensor& sensor) {
  return rig.ref_sensor && rig.ref_sensor->type == sensor.type && rig.ref_sensor->id == sensor.id;
}

// Calls visit(frame, rig, data, image) for every image of every frame. All of them exist (CheckColmapModel).
template <typename Model, typename Visit>
void ForEachFrameImage(Model& model, const Visit& visit) {
  for (auto& [frame_id, frame] : model.frames) {
    for (const ColmapFrameData& data : frame.data) {
      if (data.sensor.type != ColmapSensorType::kCamera) continue;
      visit(frame, model.rigs.at(frame.rig_id), data, model.images.at(static_cast<uint32_t>(data.data_id)));
    }
  }
}

void TakePosesFromFrames(const fs::path& frames_path, ColmapModel* model) {
  ForEachFrameImage(*model, [&](const ColmapFrame& frame, const ColmapRig& rig, const ColmapFrameData& data,
                                ColmapImage& image) {
    if (IsRefSensor(rig, data.sensor)) {
      image.cam_from_world = frame.rig_from_world;
      return;
    }
    const std::optional<Rigid3> sensor_from_rig = SensorFromRig(rig, data.sensor);
    if (!sensor_from_rig) {
      throw UserError(frames_path,
                      "image " + std::to_string(image.image_id) + " has no pose, because camera " +
                          std::to_string(image.camera_id) + " is not calibrated in rig " +
                          std::to_string(rig.rig_id),
                      "Calibrate the rig, or remove rigs and frames so that the images' own poses count");
    }
    image.cam_from_world = *sensor_from_rig * frame.rig_from_world;
  });
}

bool AreClose(const Rigid3& a, const Rigid3& b, double length) {
  // [rad / 10] and of the length: what text with 17 digits and a few products lose.
  constexpr double kTolerance = 1e-9;
  return a.rotation.angularDistance(b.rotation) <= kTolerance * 10 &&
         (a.translation - b.translation).norm() <= kTolerance * length;
}

// Whether the frames give each image the pose that it has.
bool FramesAgreeWithImages(const ColmapModel& model) {
  bool agree = true;
  ForEachFrameImage(model, [&](const ColmapFrame& frame, const ColmapRig& rig, const ColmapFrameData& data,
                               const ColmapImage& image) {
    const std::optional<Rigid3> sensor_from_rig = SensorFromRig(rig, data.sensor);
    if (!sensor_from_rig) {
      agree = false;
      return;
    }
    const double length =
        std::max({image.cam_from_world.translation.norm(), frame.rig_from_world.translation.norm(),
                  sensor_from_rig->translation.norm()});
    agree = agree && AreClose(*sensor_from_rig * frame.rig_from_world, image.cam_from_world, length);
  });
  return agree;
}

bool EveryImageHasItsFrame(const ColmapModel& model) {
  size_t num_images = 0;
  for (const auto& [frame_id, frame] : model.frames) {
    const auto rig = model.rigs.find(frame.rig_id);
    if (rig == model.rigs.end()) return false;
    for (const ColmapFrameData& data : frame.data) {
      if (data.sensor.type != ColmapSensorType::kCamera) continue;
      const auto image = model.images.find(static_cast<uint32_t>(data.data_id));
      if (image == model.images.end() || image->second.camera_id != data.sensor.id) return false;
      if (!SensorFromRig(rig->second, data.sensor)) return false;
      ++num_images;
    }
  }
  return num_images == model.images.size();
}

// Moves each frame to where its reference camera stands now, or its last camera when that took no image.
void MoveFramesWithImages(ColmapModel* model) {
  std::map<uint32_t, bool> has_reference;
  ForEachFrameImage(*model, [&](ColmapFrame& frame, const ColmapRig& rig, const ColmapFrameData& data,
                                const ColmapImage& image) {
    bool& placed = has_reference[frame.frame_id];
    if (placed) return;
    if (IsRefSensor(rig, data.sensor)) {
      frame.rig_from_world = image.cam_from_world;
      placed = true;
    } else {
      frame.rig_from_world = SensorFromRig(rig, data.sensor)->Inverse() * image.cam_from_world;
    }
  });
}

void UseTrivialRigs(ColmapModel* model) {
  model->rigs.clear();
  model->frames.clear();
  for (const auto& [id, camera] : model->cameras) {
    model->rigs[id] = {id, ColmapSensor{ColmapSensorType::kCamera, id}, {}};
  }
  for (const auto& [id, image] : model->images) {
    const ColmapSensor sensor{ColmapSensorType::kCamera, image.camera_id};
    model->frames[id] = {id, image.camera_id, image.cam_from_world, {{sensor, id}}};
  }
}

// The model's rigs and frames, changed as little as the poses of its images ask for.
void ReconcileFramesWithImages(ColmapModel* model) {
  if (!EveryImageHasItsFrame(*model)) {
    UseTrivialRigs(model);
    return;
  }
  if (FramesAgreeWithImages(*model)) return;
  MoveFramesWithImages(model);
  if (!FramesAgreeWithImages(*model)) UseTrivialRigs(model);
}

}  // namespace

ColmapModel ReadColmapModel(const fs::path& folder) {
  const ColmapFormat format = FormatIn(folder);
  ColmapModel model;
  model.cameras = ReadColmapCameras(FilePath(folder, "cameras", format));
  model.images = ReadColmapImages(FilePath(folder, "images", format));
  model.points3D = ReadColmapPoints3D(FilePath(folder, "points3D", format));
  const fs::path rigs_path = FilePath(folder, "rigs", format);
  const fs::path frames_path = FilePath(folder, "frames", format);
  if (Exists(rigs_path) != Exists(frames_path)) {
    throw UserError(Exists(rigs_path) ? frames_path : rigs_path, "no such file, but its counterpart exists",
                    "Rigs and frames belong together: restore the file, or remove the other one so that the "
                    "images' own poses count");
  }
  if (Exists(rigs_path)) {
    model.rigs = ReadColmapRigs(rigs_path);
    model.frames = ReadColmapFrames(frames_path);
  }
  CheckColmapModel(model, folder, format);
  TakePosesFromFrames(frames_path, &model);
  return model;
}

void WriteColmapModel(const fs::path& folder, const ColmapModel& model, ColmapFormat format) {
  ColmapModel frames_model;
  const ColmapModel* written = &model;
  if (!model.rigs.empty() || !model.frames.empty()) {
    frames_model = model;
    ReconcileFramesWithImages(&frames_model);
    written = &frames_model;
  }
  CheckColmapModel(*written, folder, format);
  CreateFolder(folder);

  std::vector<fs::path> obsolete;
  const ColmapFormat other = format == ColmapFormat::kBinary ? ColmapFormat::kText : ColmapFormat::kBinary;
  for (const char* name : kAllFiles) obsolete.push_back(FilePath(folder, name, other));
  std::vector<FileToWrite> files = {
      {FilePath(folder, "cameras", format),
       [&](std::ostream& stream) { WriteColmapCameras(stream, format, written->cameras); }},
      {FilePath(folder, "images", format),
       [&](std::ostream& stream) { WriteColmapImages(stream, format, written->images); }},
      {FilePath(folder, "points3D", format),
       [&](std::ostream& stream) { WriteColmapPoints3D(stream, format, written->points3D); }},
  };
  const fs::path rigs_path = FilePath(folder, "rigs", format);
  const fs::path frames_path = FilePath(folder, "frames", format);
  if (!written->rigs.empty() || !written->frames.empty()) {
    files.push_back(
        {rigs_path, [&](std::ostream& stream) { WriteColmapRigs(stream, format, written->rigs); }});
    files.push_back(
        {frames_path, [&](std::ostream& stream) { WriteColmapFrames(stream, format, written->frames); }});
  } else {
    // Frames first: rigs alone give no image a pose.
    obsolete.push_back(frames_path);
    obsolete.push_back(rigs_path);
  }
  WriteFilesTogether(files, obsolete);
}

// The two versions of each reader and writer.
#define S2GS_COLMAP_FILE(Kind, Items)                                                                   \
  Items ReadColmap##Kind(std::istream& stream, ColmapFormat format, const fs::path& path) {             \
    return format == ColmapFormat::kBinary ? colmap_binary::Read##Kind(stream, path)                    \
                                           : colmap_text::Read##Kind(stream, path);                     \
  }                                                                                                     \
  Items ReadColmap##Kind(const fs::path& path) {                                                        \
    const ColmapFormat format = FormatOf(path);                                                         \
    std::ifstream stream = OpenForReading(path, "Run the stage that writes it, or restore it");         \
    return ReadColmap##Kind(stream, format, path);                                                      \
  }                                                                                                     \
  void WriteColmap##Kind(std::ostream& stream, ColmapFormat format, const Items& items) {               \
    format == ColmapFormat::kBinary ? colmap_binary::Write(stream, items)                               \
                                    : colmap_text::Write(stream, items);                                \
  }                                                                                                     \
  void WriteColmap##Kind(const fs::path& path, const Items& items) {                                    \
    const ColmapFormat format = FormatOf(path);                                                         \
    WriteFileAtomically(path, [&](std::ostream& stream) { WriteColmap##Kind(stream, format, items); }); \
  }

using Cameras = std::map<uint32_t, Camera>;
using Images = std::map<uint32_t, ColmapImage>;
using Points3D = std::map<uint64_t, ColmapPoint3D>;
using Rigs = std::map<uint32_t, ColmapRig>;
using Frames = std::map<uint32_t, ColmapFrame>;
S2GS_COLMAP_FILE(Cameras, Cameras)
S2GS_COLMAP_FILE(Images, Images)
S2GS_COLMAP_FILE(Points3D, Points3D)
S2GS_COLMAP_FILE(Rigs, Rigs)
S2GS_COLMAP_FILE(Frames, Frames)
#undef S2GS_COLMAP_FILE

}  // namespace s2gs
