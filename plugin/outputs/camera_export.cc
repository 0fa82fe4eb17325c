#include "plugin/outputs/camera_export.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <map>
#include <set>
#include <utility>
#include <vector>

#include "plugin/report/html_writer.h"
#include "sfm_split/base/error.h"
#include "sfm_split/scene/camera_model.h"
#include "sfm_split/scene/io/ply_file.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

// OpenCV's model without its higher terms, which the pinhole and radial models are parts of.
struct OpenCvLens {
  double fx = 0, fy = 0, cx = 0, cy = 0;  // [px]
  double k1 = 0, k2 = 0, p1 = 0, p2 = 0;
};

OpenCvLens LensOf(const Camera& camera, const fs::path& model_path) {
  OpenCvLens lens;
  const std::vector<double>& p = camera.params;
  const size_t extra = InfoOf(camera.model).FirstExtraParam();
  switch (camera.model) {
    case CameraModelId::kSimplePinhole:
    case CameraModelId::kPinhole:
      break;
    case CameraModelId::kSimpleRadial:
      lens.k1 = p[extra];
      break;
    case CameraModelId::kRadial:
      lens.k1 = p[extra];
      lens.k2 = p[extra + 1];
      break;
    case CameraModelId::kOpenCV:
      lens.k1 = p[extra];
      lens.k2 = p[extra + 1];
      lens.p1 = p[extra + 2];
      lens.p2 = p[extra + 3];
      break;
    default:
      throw UserError(model_path,
                      fmt::format("camera {} is a {}, which this file cannot say", camera.camera_id,
                                  InfoOf(camera.model).name),
                      "Export --output_type splat_set, whose photos have no distortion");
  }
  const Eigen::Vector2d focal = FocalLengths(camera);
  const Eigen::Vector2d principal = PrincipalPoint(camera);
  lens.fx = focal.x();
  lens.fy = focal.y();
  lens.cx = principal.x();
  lens.cy = principal.y();
  return lens;
}

std::map<std::string, const ColmapImage*> ByName(const ColmapModel& model) {
  std::map<std::string, const ColmapImage*> images;
  for (const auto& [id, image] : model.images) images[image.name] = &image;
  return images;
}

}  // namespace

nlohmann::ordered_json NerfTransforms(const ColmapModel& model, const NerfPaths& paths,
                                      const fs::path& model_path) {
  nlohmann::ordered_json json;
  json["camera_model"] = "OPENCV";
  if (!paths.sparse_points.empty()) json["ply_file_path"] = paths.sparse_points;
  json["frames"] = nlohmann::ordered_json::array();
  for (const auto& [name, image] : ByName(model)) {
    const Camera& camera = model.cameras.at(image->camera_id);
    const OpenCvLens lens = LensOf(camera, model_path);
    nlohmann::ordered_json frame;
    frame["file_path"] = paths.images + name;
    if (!paths.masks.empty()) frame["mask_path"] = paths.masks + name + ".png";
    frame["w"] = camera.width;
    frame["h"] = camera.height;
    frame["fl_x"] = lens.fx;
    frame["fl_y"] = lens.fy;
    frame["cx"] = lens.cx;
    frame["cy"] = lens.cy;
    frame["k1"] = lens.k1;
    frame["k2"] = lens.k2;
    frame["p1"] = lens.p1;
    frame["p2"] = lens.p2;
    Eigen::Matrix4d world_from_camera = image->cam_from_world.Inverse().Matrix();
    world_from_camera.col(1) *= -1;
    world_from_camera.col(2) *= -1;
    for (int row = 0; row < 4; ++row) {
      for (int column = 0; column < 4; ++column) {
        frame["transform_matrix"][row].push_back(world_from_camera(row, column));
      }
    }
    json["frames"].push_back(std::move(frame));
  }
  return json;
}

void WriteMetashapeCameras(const ColmapModel& model, const fs::path& model_path, std::ostream& stream) {
  stream << "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<document version=\"1.5.0\">\n"
         << "  <chunk label=\"s2gs\" enabled=\"true\">\n"
         << fmt::format("    <sensors next_id=\"{}\">\n", model.cameras.size());
  std::map<uint32_t, size_t> sensors;
  for (const auto& [id, camera] : model.cameras) {
    const OpenCvLens lens = LensOf(camera, model_path);
    const size_t sensor = sensors.size();
    sensors[id] = sensor;
    const std::string resolution =
        fmt::format("<resolution width=\"{}\" height=\"{}\"/>", camera.width, camera.height);
    stream << fmt::format("      <sensor id=\"{}\" label=\"camera {}\" type=\"frame\">\n", sensor, id)
           << "        " << resolution << "\n        <calibration type=\"frame\" class=\"adjusted\">\n"
           << "          " << resolution << '\n';
    const std::array<std::pair<const char*, double>, 8> values = {
        {{"f", lens.fy},
         {"cx", lens.cx - 0.5 * static_cast<double>(camera.width)},
         {"cy", lens.cy - 0.5 * static_cast<double>(camera.height)},
         {"b1", lens.fx - lens.fy},
         {"k1", lens.k1},
         {"k2", lens.k2},
         {"p1", lens.p2},
         {"p2", lens.p1}}};
    for (const auto& [name, value] : values) stream << fmt::format("          <{0}>{1}</{0}>\n", name, value);
    stream << "        </calibration>\n      </sensor>\n";
  }
  stream << "    </sensors>\n" << fmt::format("    <cameras next_id=\"{}\">\n", model.images.size());
  const std::map<std::string, const ColmapImage*> images = ByName(model);
  std::set<std::string> stems;
  for (const auto& [name, image] : images) stems.insert(fs::path(name).stem().string());
  const bool has_stems = stems.size() == images.size();
  size_t id = 0;
  for (const auto& [name, image] : images) {
    stream << fmt::format(
        "      <camera id=\"{}\" sensor_id=\"{}\" label=\"{}\" enabled=\"true\">\n        <transform>", id++,
        sensors.at(image->camera_id), EscapeHtml(has_stems ? fs::path(name).stem().string() : name));
    const Eigen::Matrix4d chunk_from_camera = image->cam_from_world.Inverse().Matrix();
    for (int i = 0; i < 16; ++i)
      stream << (i > 0 ? " " : "") << fmt::format("{}", chunk_from_camera(i / 4, i % 4));
    stream << "</transform>\n      </camera>\n";
  }
  stream << "    </cameras>\n  </chunk>\n</document>\n";
}

void WritePointsPly(const ColmapModel& model, const fs::path& path) {
  std::array<std::vector<float>, 3> xyz;
  std::array<std::vector<uint8_t>, 3> rgb;
  for (const auto& [id, point] : model.points3D) {
    for (int i = 0; i < 3; ++i) {
      xyz[static_cast<size_t>(i)].push_back(static_cast<float>(point.xyz[i]));
      rgb[static_cast<size_t>(i)].push_back(point.rgb[i]);
    }
  }
  PlyElement vertex;
  vertex.name = "vertex";
  vertex.num_rows = model.points3D.size();
  const std::array<const char*, 3> colors = {"red", "green", "blue"};
  for (size_t i = 0; i < 3; ++i) vertex.AddColumn({"xyz"[i]}, std::move(xyz[i]));
  for (size_t i = 0; i < 3; ++i) vertex.AddColumn(colors[i], std::move(rgb[i]));
  PlyFile file;
  file.elements.push_back(std::move(vertex));
  WritePly(path, file);
}

}  // namespace s2gs
