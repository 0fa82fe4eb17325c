#include <string>
#include <string_view>
#include <utility>

#include "sfm_split/base/text_reader.h"
#include "sfm_split/scene/io/colmap_model_files.h"

namespace s2gs::colmap_text {
namespace {

Rigid3 ReadPose(TextReader& reader, const char* what) {
  Eigen::Matrix<double, 7, 1> numbers;
  for (double& number : numbers) number = reader.Number<double>(what);
  const std::optional<Rigid3> pose = PoseFromNumbers(numbers);
  if (!pose)
    reader.Fail(std::string(what) + " is no rigid transform (a number not finite, or rotation zero)");
  return *pose;
}

ColmapSensor ReadSensor(TextReader& reader) {
  ColmapSensor sensor;
  const std::string_view type = reader.Word("sensor type");
  if (type == "CAMERA") {
    sensor.type = ColmapSensorType::kCamera;
  } else if (type == "IMU") {
    sensor.type = ColmapSensorType::kImu;
  } else {
    reader.Fail("the sensor type is unknown (known are CAMERA and IMU)");
  }
  sensor.id = reader.Number<uint32_t>("sensor id");
  return sensor;
}

// Adds a sound item under its id, which must not be taken yet.
template <typename Id, typename Item>
void Add(TextReader& reader, const char* kind, Id Item::*id_field, Item item, std::map<Id, Item>* items) {
  if (const std::optional<std::string> fault = FindFault(item)) reader.Fail(*fault);
  const Id id = item.*id_field;
  if (!items->emplace(id, std::move(item)).second) {
    reader.Fail(std::string(kind) + " " + std::to_string(id) + " occurs twice");
  }
}

// One line of words with single spaces between them.
class Line {
 public:
  Line& operator<<(std::string_view word) {
    if (!text_.empty()) text_ += ' ';
    text_ += word;
    return *this;
  }
  Line& operator<<(uint64_t number) { return *this << std::string_view(std::to_string(number)); }
  Line& operator<<(double number) {
    if (!text_.empty()) text_ += ' ';
    AppendNumber(number, &text_);
    return *this;
  }
  Line& operator<<(const Rigid3& pose) {
    for (const double number : NumbersFromPose(pose)) *this << number;
    return *this;
  }
  Line& operator<<(const ColmapSensor& sensor) {
    return *this << std::string_view(sensor.type == ColmapSensorType::kCamera ? "CAMERA" : "IMU")
                 << uint64_t{sensor.id};
  }
  void EndTo(std::ostream& stream) {
    text_ += '\n';
    stream.write(text_.data(), static_cast<std::streamsize>(text_.size()));
    text_.clear();
  }

 private:
  std::string text_;
};

}  // namespace

std::map<uint32_t, Camera> ReadCameras(std::istream& stream, const std::filesystem::path& path) {
  TextReader reader(stream, path);
  std::map<uint32_t, Camera> cameras;
  while (reader.NextDataLine()) {
    Camera camera;
    camera.camera_id = reader.Number<uint32_t>("camera id");
    const CameraModelInfo* info = FindCameraModel(reader.Word("camera model"));
    if (info == nullptr) reader.Fail("the camera model is unknown");
    camera.model = info->id;
    camera.width = reader.Number<uint64_t>("image width");
    camera.height = reader.Number<uint64_t>("image height");
    for (size_t i = 0; i < info->NumParams(); ++i) {
      camera.params.push_back(reader.Number<double>("camera parameter"));
    }
    reader.ExpectLineEnd();
    Add(reader, "camera", &Camera::camera_id, std::move(camera), &cameras);
  }
  return cameras;
}

void Write(std::ostream& stream, const std::map<uint32_t, Camera>& cameras) {
  stream << "# Cameras, one a line:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n# Number of cameras: "
         << std::to_string(cameras.size()) << '\n';
  Line line;
  for (const auto& [id, camera] : cameras) {
    line << uint64_t{id} << InfoOf(camera.model).name << camera.width << camera.height;
    for (const double param : camera.params) line << param;
    line.EndTo(stream);
  }
}

std::map<uint32_t, ColmapImage> ReadImages(std::istream& stream, const std::filesystem::path& path) {
  TextReader reader(stream, path);
  std::map<uint32_t, ColmapImage> images;
  while (reader.NextDataLine()) {
    ColmapImage image;
    image.image_id = reader.Number<uint32_t>("image id");
    image.cam_from_world = ReadPose(reader, "image pose");
    image.camera_id = reader.Number<uint32_t>("camera id");
    image.name = reader.Rest();
    // The second line is blank for an image without keypoints; tools and editors drop it at the file's end.
    const bool has_line_break = reader.has_line_break();
    if (!reader.NextLine() && !has_line_break) reader.Fail("the file ends inside an image");
    while (!reader.AtLineEnd()) {
      ColmapPoint2D point;
      point.xy.x() = reader.Number<double>("keypoint x");
      point.xy.y() = reader.Number<double>("keypoint y");
      const auto id = reader.Word("point id of a keypoint");
      if (id != "-1") {
        const auto result = std::from_chars(id.data(), id.data() + id.size(), point.point3D_id);
        if (result.ec != std::errc() || result.ptr != id.data() + id.size()) {
          reader.Fail("the point id of a keypoint is no number that fits there");
        }
      }
      image.points2D.push_back(point);
    }
    Add(reader, "image", &ColmapImage::image_id, std::move(image), &images);
  }
  return images;
}

void Write(std::ostream& stream, const std::map<uint32_t, ColmapImage>& images) {
  stream << "# Images, two lines each:\n#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n"
            "#   POINTS2D[] as (X, Y, POINT3D_ID)\n# Number of images: "
         << std::to_string(images.size()) << '\n';
  Line line;
  for (const auto& [id, image] : images) {
    line << uint64_t{id} << image.cam_from_world << uint64_t{image.camera_id} << image.name;
    line.EndTo(stream);
    for (const ColmapPoint2D& point : image.points2D) {
      line << point.xy.x() << point.xy.y();
      if (point.point3D_id == kInvalidPoint3DId) {
        line << std::string_view("-1");
      } else {
        line << point.point3D_id;
      }
    }
    line.EndTo(stream);
  }
}

std::map<uint64_t, ColmapPoint3D> ReadPoints3D(std::istream& stream, const std::filesystem::path& path) {
  TextReader reader(stream, path);
  std::map<uint64_t, ColmapPoint3D> points3D;
  while (reader.NextDataLine()) {
    ColmapPoint3D point;
    point.point3D_id = reader.Number<uint64_t>("point id");
    for (int i = 0; i < 3; ++i) point.xyz[i] = reader.Number<double>("point position");
    for (int i = 0; i < 3; ++i) point.rgb[i] = reader.Number<uint8_t>("point colour");
    point.error = reader.Number<double>("point error");
    while (!reader.AtLineEnd()) {
      const auto image_id = reader.Number<uint32_t>("image id of a track");
      point.track.push_back({image_id, reader.Number<uint32_t>("keypoint index of a track")});
    }
    Add(reader, "point", &ColmapPoint3D::point3D_id, std::move(point), &points3D);
  }
  return points3D;
}

void Write(std::ostream& stream, const std::map<uint64_t, ColmapPoint3D>& points3D) {
  stream << "# 3D points, one a line:\n#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, "
            "POINT2D_IDX)\n# Number of points: "
         << std::to_string(points3D.size()) << '\n';
  Line line;
  for (const auto& [id, point] : points3D) {
    line << id << point.xyz.x() << point.xyz.y() << point.xyz.z();
    for (int i = 0; i < 3; ++i) line << uint64_t{point.rgb[i]};
    line << point.error;
    for (const ColmapTrackElement& element : point.track) {
      line << uint64_t{element.image_id} << uint64_t{element.point2D_idx};
    }
    line.EndTo(stream);
  }
}

std::map<uint32_t, ColmapRig> ReadRigs(std::istream& stream, const std::filesystem::path& path) {
  TextReader reader(stream, path);
  std::map<uint32_t, ColmapRig> rigs;
  while (reader.NextDataLine()) {
    ColmapRig rig;
    rig.rig_id = reader.Number<uint32_t>("rig id");
    const auto num_sensors = reader.Number<uint32_t>("number of sensors");
    if (num_sensors > 0) rig.ref_sensor = ReadSensor(reader);
    for (uint32_t i = 1; i < num_sensors; ++i) {
      ColmapRigSensor sensor{ReadSensor(reader), std::nullopt};
      const std::string_view has_pose = reader.Word("pose mark");
      if (has_pose != "0" && has_pose != "1") reader.Fail("the pose mark of a sensor is not 0 or 1");
      if (has_pose == "1") sensor.sensor_from_rig = ReadPose(reader, "sensor pose");
      rig.sensors.push_back(sensor);
    }
    reader.ExpectLineEnd();
    Add(reader, "rig", &ColmapRig::rig_id, std::move(rig), &rigs);
  }
  return rigs;
}

void Write(std::ostream& stream, const std::map<uint32_t, ColmapRig>& rigs) {
  stream << "# Rigs, one a line:\n#   RIG_ID, NUM_SENSORS, REF_SENSOR_TYPE, REF_SENSOR_ID, SENSORS[] as "
            "(SENSOR_TYPE, SENSOR_ID, HAS_POSE, [QW, QX, QY, QZ, TX, TY, TZ])\n# Number of rigs: "
         << std::to_string(rigs.size()) << '\n';
  Line line;
  for (const auto& [id, rig] : rigs) {
    line << uint64_t{id} << uint64_t{rig.ref_sensor ? 1 + rig.sensors.size() : 0};
    if (rig.ref_sensor) line << *rig.ref_sensor;
    for (const ColmapRigSensor& sensor : rig.sensors) {
      line << sensor.sensor << uint64_t{sensor.sensor_from_rig ? 1U : 0U};
      if (sensor.sensor_from_rig) line << *sensor.sensor_from_rig;
    }
    line.EndTo(stream);
  }
}

std::map<uint32_t, ColmapFrame> ReadFrames(std::istream& stream, const std::filesystem::path& path) {
  TextReader reader(stream, path);
  std::map<uint32_t, ColmapFrame> frames;
  while (reader.NextDataLine()) {
    ColmapFrame frame;
    frame.frame_id = reader.Number<uint32_t>("frame id");
    frame.rig_id = reader.Number<uint32_t>("rig id");
    frame.rig_from_world = ReadPose(reader, "frame pose");
    const auto num_data = reader.Number<uint32_t>("number of data ids");
    for (uint32_t i = 0; i < num_data; ++i) {
      const ColmapSensor sensor = ReadSensor(reader);
      frame.data.push_back({sensor, reader.Number<uint64_t>("data id")});
    }
    reader.ExpectLineEnd();
    Add(reader, "frame", &ColmapFrame::frame_id, std::move(frame), &frames);
  }
  return frames;
}

void Write(std::ostream& stream, const std::map<uint32_t, ColmapFrame>& frames) {
  stream << "# Frames, one a line:\n#   FRAME_ID, RIG_ID, RIG_FROM_WORLD[QW, QX, QY, QZ, TX, TY, TZ], "
            "NUM_DATA_IDS, DATA_IDS[] as (SENSOR_TYPE, SENSOR_ID, DATA_ID)\n# Number of frames: "
         << std::to_string(frames.size()) << '\n';
  Line line;
  for (const auto& [id, frame] : frames) {
    line << uint64_t{id} << uint64_t{frame.rig_id} << frame.rig_from_world << uint64_t{frame.data.size()};
    for (const ColmapFrameData& data : frame.data) line << data.sensor << data.data_id;
    line.EndTo(stream);
  }
}

}  // namespace s2gs::colmap_text
