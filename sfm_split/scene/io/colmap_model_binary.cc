#include <cstring>
#include <string>
#include <utility>

#include "sfm_split/base/byte_reader.h"
#include "sfm_split/scene/io/colmap_model_files.h"

namespace s2gs::colmap_binary {
namespace {

constexpr uint64_t kMaxNameLength = 4096;  // PATH_MAX of Linux

template <typename T>
void Put(std::ostream& stream, T value) {
  stream.write(reinterpret_cast<const char*>(&value), sizeof(T));
}

Rigid3 ReadPose(ByteReader& reader, const char* what) {
  Eigen::Matrix<double, 7, 1> numbers;
  reader.ReadBytes(numbers.data(), sizeof(numbers), what);
  const std::optional<Rigid3> pose = PoseFromNumbers(numbers);
  if (!pose)
    reader.Fail(std::string(what) + " is no rigid transform (a number not finite, or rotation zero)");
  return *pose;
}

void PutPose(std::ostream& stream, const Rigid3& pose) {
  const Eigen::Matrix<double, 7, 1> numbers = NumbersFromPose(pose);
  stream.write(reinterpret_cast<const char*>(numbers.data()), sizeof(numbers));
}

ColmapSensor ReadSensor(ByteReader& reader) {
  const auto type = reader.Read<int32_t>("sensor type");
  if (type != static_cast<int>(ColmapSensorType::kCamera) &&
      type != static_cast<int>(ColmapSensorType::kImu)) {
    reader.Fail("sensor type " + std::to_string(type) + " is unknown");
  }
  return {static_cast<ColmapSensorType>(type), reader.Read<uint32_t>("sensor id")};
}

void PutSensor(std::ostream& stream, const ColmapSensor& sensor) {
  Put<int32_t>(stream, static_cast<int32_t>(sensor.type));
  Put(stream, sensor.id);
}

// Adds a sound item under its id, which must not be taken yet.
template <typename Id, typename Item>
void Add(ByteReader& reader, const char* kind, Id Item::*id_field, Item item, std::map<Id, Item>* items) {
  if (const std::optional<std::string> fault = FindFault(item)) reader.Fail(*fault);
  const Id id = item.*id_field;
  if (!items->emplace(id, std::move(item)).second) {
    reader.Fail(std::string(kind) + " " + std::to_string(id) + " occurs twice");
  }
}

}  // namespace

std::map<uint32_t, Camera> ReadCameras(std::istream& stream, const std::filesystem::path& path) {
  ByteReader reader(stream, path);
  std::map<uint32_t, Camera> cameras;
  const uint64_t count = reader.ReadCount(4 + 4 + 8 + 8 + 2 * 8, "number of cameras");
  for (uint64_t i = 0; i < count; ++i) {
    Camera camera;
    camera.camera_id = reader.Read<uint32_t>("camera id");
    const auto model = reader.Read<int32_t>("camera model");
    const CameraModelInfo* info = FindCameraModel(model);
    if (info == nullptr) {
      reader.Fail("camera model " + std::to_string(model) + " is unknown (up to COLMAP 4.2 they end at " +
                  std::to_string(static_cast<int>(CameraModelId::kEquirectangular)) + ")");
    }
    camera.model = info->id;
    camera.width = reader.Read<uint64_t>("image width");
    camera.height = reader.Read<uint64_t>("image height");
    camera.params = reader.ReadVector<double>(info->NumParams(), "camera parameters");
    Add(reader, "camera", &Camera::camera_id, std::move(camera), &cameras);
  }
  reader.ExpectEnd();
  return cameras;
}

void Write(std::ostream& stream, const std::map<uint32_t, Camera>& cameras) {
  Put<uint64_t>(stream, cameras.size());
  for (const auto& [id, camera] : cameras) {
    Put(stream, id);
    Put<int32_t>(stream, static_cast<int32_t>(camera.model));
    Put(stream, camera.width);
    Put(stream, camera.height);
    for (const double param : camera.params) Put(stream, param);
  }
}

std::map<uint32_t, ColmapImage> ReadImages(std::istream& stream, const std::filesystem::path& path) {
  constexpr size_t kPoint2DBytes = 8 + 8 + 8;  // x, y, id of the point
  ByteReader reader(stream, path);
  std::map<uint32_t, ColmapImage> images;
  const uint64_t count = reader.ReadCount(4 + 7 * 8 + 4 + 1 + 8, "number of images");
  for (uint64_t i = 0; i < count; ++i) {
    ColmapImage image;
    image.image_id = reader.Read<uint32_t>("image id");
    image.cam_from_world = ReadPose(reader, "image pose");
    image.camera_id = reader.Read<uint32_t>("camera id");
    image.name = reader.ReadCString(kMaxNameLength, "image name");
    const uint64_t num_points2D = reader.ReadCount(kPoint2DBytes, "number of keypoints");
    const std::vector<uint8_t> bytes = reader.ReadVector<uint8_t>(num_points2D * kPoint2DBytes, "keypoints");
    image.points2D.resize(num_points2D);
    for (uint64_t j = 0; j < num_points2D; ++j) {
      const uint8_t* source = bytes.data() + j * kPoint2DBytes;
      std::memcpy(image.points2D[j].xy.data(), source, 16);
      std::memcpy(&image.points2D[j].point3D_id, source + 16, 8);
    }
    Add(reader, "image", &ColmapImage::image_id, std::move(image), &images);
  }
  reader.ExpectEnd();
  return images;
}

void Write(std::ostream& stream, const std::map<uint32_t, ColmapImage>& images) {
  Put<uint64_t>(stream, images.size());
  for (const auto& [id, image] : images) {
    Put(stream, id);
    PutPose(stream, image.cam_from_world);
    Put(stream, image.camera_id);
    stream.write(image.name.c_str(), static_cast<std::streamsize>(image.name.size() + 1));
    Put<uint64_t>(stream, image.points2D.size());
    for (const ColmapPoint2D& point : image.points2D) {
      Put(stream, point.xy.x());
      Put(stream, point.xy.y());
      Put(stream, point.point3D_id);
    }
  }
}

std::map<uint64_t, ColmapPoint3D> ReadPoints3D(std::istream& stream, const std::filesystem::path& path) {
  constexpr size_t kTrackElementBytes = 4 + 4;  // ids of image and keypoint
  ByteReader reader(stream, path);
  std::map<uint64_t, ColmapPoint3D> points3D;
  const uint64_t count = reader.ReadCount(8 + 3 * 8 + 3 + 8 + 8, "number of 3D points");
  for (uint64_t i = 0; i < count; ++i) {
    ColmapPoint3D point;
    point.point3D_id = reader.Read<uint64_t>("point id");
    reader.ReadBytes(point.xyz.data(), 24, "point position");
    reader.ReadBytes(point.rgb.data(), 3, "point colour");
    point.error = reader.Read<double>("point error");
    const uint64_t length = reader.ReadCount(kTrackElementBytes, "track length");
    const std::vector<uint32_t> numbers = reader.ReadVector<uint32_t>(2 * length, "track");
    point.track.resize(length);
    for (uint64_t j = 0; j < length; ++j) point.track[j] = {numbers[2 * j], numbers[2 * j + 1]};
    Add(reader, "point", &ColmapPoint3D::point3D_id, std::move(point), &points3D);
  }
  reader.ExpectEnd();
  return points3D;
}

void Write(std::ostream& stream, const std::map<uint64_t, ColmapPoint3D>& points3D) {
  Put<uint64_t>(stream, points3D.size());
  for (const auto& [id, point] : points3D) {
    Put(stream, id);
    for (int i = 0; i < 3; ++i) Put(stream, point.xyz[i]);
    for (int i = 0; i < 3; ++i) Put(stream, point.rgb[i]);
    Put(stream, point.error);
    Put<uint64_t>(stream, point.track.size());
    for (const ColmapTrackElement& element : point.track) {
      Put(stream, element.image_id);
      Put(stream, element.point2D_idx);
    }
  }
}

std::map<uint32_t, ColmapRig> ReadRigs(std::istream& stream, const std::filesystem::path& path) {
  ByteReader reader(stream, path);
  std::map<uint32_t, ColmapRig> rigs;
  const uint64_t count = reader.ReadCount(4 + 4, "number of rigs");
  for (uint64_t i = 0; i < count; ++i) {
    ColmapRig rig;
    rig.rig_id = reader.Read<uint32_t>("rig id");
    const auto num_sensors = reader.Read<uint32_t>("number of sensors");
    reader.CheckCount(num_sensors, 4 + 4, "number of sensors");
    if (num_sensors > 0) rig.ref_sensor = ReadSensor(reader);
    for (uint32_t j = 1; j < num_sensors; ++j) {
      ColmapRigSensor sensor{ReadSensor(reader), std::nullopt};
      const auto has_pose = reader.Read<uint8_t>("pose mark");
      if (has_pose > 1) reader.Fail("pose mark is " + std::to_string(has_pose) + ", not 0 or 1");
      if (has_pose == 1) sensor.sensor_from_rig = ReadPose(reader, "sensor pose");
      rig.sensors.push_back(sensor);
    }
    Add(reader, "rig", &ColmapRig::rig_id, std::move(rig), &rigs);
  }
  reader.ExpectEnd();
  return rigs;
}

void Write(std::ostream& stream, const std::map<uint32_t, ColmapRig>& rigs) {
  Put<uint64_t>(stream, rigs.size());
  for (const auto& [id, rig] : rigs) {
    Put(stream, id);
    Put<uint32_t>(stream, rig.ref_sensor ? 1 + static_cast<uint32_t>(rig.sensors.size()) : 0);
    if (rig.ref_sensor) PutSensor(stream, *rig.ref_sensor);
    for (const ColmapRigSensor& sensor : rig.sensors) {
      PutSensor(stream, sensor.sensor);
      Put<uint8_t>(stream, sensor.sensor_from_rig ? 1 : 0);
      if (sensor.sensor_from_rig) PutPose(stream, *sensor.sensor_from_rig);
    }
  }
}

std::map<uint32_t, ColmapFrame> ReadFrames(std::istream& stream, const std::filesystem::path& path) {
  ByteReader reader(stream, path);
  std::map<uint32_t, ColmapFrame> frames;
  const uint64_t count = reader.ReadCount(4 + 4 + 7 * 8 + 4, "number of frames");
  for (uint64_t i = 0; i < count; ++i) {
    ColmapFrame frame;
    frame.frame_id = reader.Read<uint32_t>("frame id");
    frame.rig_id = reader.Read<uint32_t>("rig id");
    frame.rig_from_world = ReadPose(reader, "frame pose");
    const auto num_data = reader.Read<uint32_t>("number of data ids");
    reader.CheckCount(num_data, 4 + 4 + 8, "number of data ids");
    for (uint32_t j = 0; j < num_data; ++j) {
      const ColmapSensor sensor = ReadSensor(reader);
      frame.data.push_back({sensor, reader.Read<uint64_t>("data id")});
    }
    Add(reader, "frame", &ColmapFrame::frame_id, std::move(frame), &frames);
  }
  reader.ExpectEnd();
  return frames;
}

void Write(std::ostream& stream, const std::map<uint32_t, ColmapFrame>& frames) {
  Put<uint64_t>(stream, frames.size());
  for (const auto& [id, frame] : frames) {
    Put(stream, id);
    Put(stream, frame.rig_id);
    PutPose(stream, frame.rig_from_world);
    Put<uint32_t>(stream, static_cast<uint32_t>(frame.data.size()));
    for (const ColmapFrameData& data : frame.data) {
      PutSensor(stream, data.sensor);
      Put(stream, data.data_id);
    }
  }
}

}  // namespace s2gs::colmap_binary
