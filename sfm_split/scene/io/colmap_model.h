#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <istream>
#include <limits>
#include <map>
#include <optional>
#include <ostream>
#include <string>
#include <vector>

#include "sfm_split/base/rigid3.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

constexpr uint64_t kInvalidPoint3DId = std::numeric_limits<uint64_t>::max();  // COLMAP's "none"

/// A keypoint of a registered image and the 3D point it sees, if any.
struct ColmapPoint2D {
  Eigen::Vector2d xy = Eigen::Vector2d::Zero();  ///< [px], COLMAP's pixel convention.
  uint64_t point3D_id = kInvalidPoint3DId;
};

struct ColmapImage {
  uint32_t image_id = 0;
  std::string name;  ///< path relative to the image folder.
  uint32_t camera_id = 0;
  Rigid3 cam_from_world;
  std::vector<ColmapPoint2D> points2D;
};

struct ColmapTrackElement {
  uint32_t image_id = 0;
  uint32_t point2D_idx = 0;
};

struct ColmapPoint3D {
  uint64_t point3D_id = kInvalidPoint3DId;
  Eigen::Vector3d xyz = Eigen::Vector3d::Zero();
  Eigen::Matrix<uint8_t, 3, 1> rgb = Eigen::Matrix<uint8_t, 3, 1>::Zero();
  double error = -1;  ///< mean reprojection error [px]; negative when unknown.
  std::vector<ColmapTrackElement> track;
};

enum class ColmapSensorType : int { kCamera = 0, kImu = 1 };

/// A camera (then `id` is a camera id) or another sensor.
struct ColmapSensor {
  ColmapSensorType type = ColmapSensorType::kCamera;
  uint32_t id = 0;
};

struct ColmapRigSensor {
  ColmapSensor sensor;
  std::optional<Rigid3> sensor_from_rig;  ///< nothing when not calibrated yet.
};

/// Sensors that are fixed to each other. The rig's frame is that of its reference sensor.
struct ColmapRig {
  uint32_t rig_id = 0;
  std::optional<ColmapSensor> ref_sensor;  ///< nothing when the rig has no sensors at all.
  std::vector<ColmapRigSensor> sensors;    ///< without the reference sensor.
};

/// One measurement of a frame: for a camera, `data_id` is an image id.
struct ColmapFrameData {
  ColmapSensor sensor;
  uint64_t data_id = 0;
};

/// One moment of a rig. cam_from_world of its images == sensor_from_rig * rig_from_world.
struct ColmapFrame {
  uint32_t frame_id = 0;
  uint32_t rig_id = 0;
  Rigid3 rig_from_world;
  std::vector<ColmapFrameData> data;
};

/// A sparse model as COLMAP stores it in a folder (cameras, images, points3D; rigs and frames from 3.12 on).
/// Keys are the ids that the values carry. Rigs and frames are either both empty, or every image is in
/// exactly one frame.
struct ColmapModel {
  std::map<uint32_t, Camera> cameras;
  std::map<uint32_t, ColmapImage> images;
  std::map<uint64_t, ColmapPoint3D> points3D;
  std::map<uint32_t, ColmapRig> rigs;
  std::map<uint32_t, ColmapFrame> frames;
};

enum class ColmapFormat { kBinary, kText };

/// Reads the model in a folder: the binary files when all are there, else the text files. When the folder has
/// rigs and frames with content, the images' poses come from them, as in COLMAP 3.12 and newer.
/// Throws UserError when a file is missing or damaged, or CheckColmapModel finds a fault.
ColmapModel ReadColmapModel(const std::filesystem::path& folder);

/// Writes a model so that every version of COLMAP sees the poses of `model.images`. With rigs and frames in
/// the model both files are written; frames that contradict the images' poses (or miss an image) are moved
/// with them, or, where a rig no longer fits, all replaced by one rig a camera and one frame an image, as
/// COLMAP does with models that have none. Without them no such file is left in the folder. The folder is
/// created. Files of the other format are removed, because readers would prefer or mix them. All files are
/// complete on disk before the first one is replaced: a full disk changes nothing. Throws UserError like
/// CheckColmapModel, and when a file cannot be written.
void WriteColmapModel(const std::filesystem::path& folder, const ColmapModel& model, ColmapFormat format);

/// Checks what single files cannot tell: that every reference between cameras, images, points, rigs and
/// frames leads somewhere, in both directions, that names are unique, poses finite and cameras usable. Throws
/// UserError that names the file of `folder` at fault.
void CheckColmapModel(const ColmapModel& model, const std::filesystem::path& folder, ColmapFormat format);

/// Single files. Reading checks all that the file alone can tell; the poses of images are those in the file.
/// The stream versions take the path for messages only. The path versions choose the format by the extension,
/// .bin or .txt, and write atomically. Binary streams must be seekable.
std::map<uint32_t, Camera> ReadColmapCameras(std::istream& stream, ColmapFormat format,
                                             const std::filesystem::path& path);
std::map<uint32_t, Camera> ReadColmapCameras(const std::filesystem::path& path);
std::map<uint32_t, ColmapImage> ReadColmapImages(std::istream& stream, ColmapFormat format,
                                                 const std::filesystem::path& path);
std::map<uint32_t, ColmapImage> ReadColmapImages(const std::filesystem::path& path);
std::map<uint64_t, ColmapPoint3D> ReadColmapPoints3D(std::istream& stream, ColmapFormat format,
                                                     const std::filesystem::path& path);
std::map<uint64_t, ColmapPoint3D> ReadColmapPoints3D(const std::filesystem::path& path);
std::map<uint32_t, ColmapRig> ReadColmapRigs(std::istream& stream, ColmapFormat format,
                                             const std::filesystem::path& path);
std::map<uint32_t, ColmapRig> ReadColmapRigs(const std::filesystem::path& path);
std::map<uint32_t, ColmapFrame> ReadColmapFrames(std::istream& stream, ColmapFormat format,
                                                 const std::filesystem::path& path);
std::map<uint32_t, ColmapFrame> ReadColmapFrames(const std::filesystem::path& path);

void WriteColmapCameras(std::ostream& stream, ColmapFormat format, const std::map<uint32_t, Camera>& cameras);
void WriteColmapCameras(const std::filesystem::path& path, const std::map<uint32_t, Camera>& cameras);
void WriteColmapImages(std::ostream& stream, ColmapFormat format,
                       const std::map<uint32_t, ColmapImage>& images);
void WriteColmapImages(const std::filesystem::path& path, const std::map<uint32_t, ColmapImage>& images);
void WriteColmapPoints3D(std::ostream& stream, ColmapFormat format,
                         const std::map<uint64_t, ColmapPoint3D>& points3D);
void WriteColmapPoints3D(const std::filesystem::path& path,
                         const std::map<uint64_t, ColmapPoint3D>& points3D);
void WriteColmapRigs(std::ostream& stream, ColmapFormat format, const std::map<uint32_t, ColmapRig>& rigs);
void WriteColmapRigs(const std::filesystem::path& path, const std::map<uint32_t, ColmapRig>& rigs);
void WriteColmapFrames(std::ostream& stream, ColmapFormat format,
                       const std::map<uint32_t, ColmapFrame>& frames);
void WriteColmapFrames(const std::filesystem::path& path, const std::map<uint32_t, ColmapFrame>& frames);

}  // namespace s2gs
