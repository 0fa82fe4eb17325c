#include "tests/support/synthetic_models.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/scene/camera_model.h"

namespace s2gs {
namespace {

/// x_in_cam of the new pose is the old one's times the similarity's scale.
Rigid3 CamFromModel(const Rigid3& cam_from_body, const Sim3& model_from_body) {
  const Eigen::Quaterniond rotation =
      (cam_from_body.rotation * model_from_body.rotation.conjugate()).normalized();
  return {rotation,
          model_from_body.scale * cam_from_body.translation - rotation * model_from_body.translation};
}

ColmapModel MakeModel(const SyntheticTurntable& turntable, bool rotating, const Sim3& model_from_body) {
  ColmapModel model;
  for (const Camera& camera : turntable.scene.cameras) model.cameras[camera.camera_id] = camera;
  for (size_t i = 0; i < turntable.points.size(); ++i) {
    const SyntheticPoint& point = turntable.points[i];
    if (IsRotating(point.body) != rotating) continue;
    ColmapPoint3D& point3D = model.points3D[i + 1];
    point3D.point3D_id = i + 1;
    point3D.xyz = model_from_body * point.x;
    point3D.rgb = point.color;
    point3D.error = 0;
  }
  for (size_t i = 0; i < turntable.images.size(); ++i) {
    const View& view = turntable.scene.views[i];
    ColmapImage& image = model.images[static_cast<uint32_t>(i + 1)];
    image.image_id = static_cast<uint32_t>(i + 1);
    image.name = view.name;
    image.camera_id = view.camera_id;
    image.cam_from_world =
        CamFromModel(rotating ? view.CamFromObject() : view.cam_from_world, model_from_body);
    for (const SyntheticKeypoint& keypoint : turntable.images[i].keypoints) {
      ColmapPoint2D point2D;
      point2D.xy = keypoint.xy;
      const bool moved = keypoint.body == SyntheticBody::kPlatter && turntable.images[i].flipped;
      const bool sees =
          rotating ? IsRotating(keypoint.body) && !moved : keypoint.body == SyntheticBody::kStatic;
      if (sees) {
        point2D.point3D_id = static_cast<uint64_t>(keypoint.point) + 1;
        model.points3D[point2D.point3D_id].track.push_back(
            {image.image_id, static_cast<uint32_t>(image.points2D.size())});
      }
      image.points2D.push_back(point2D);
    }
  }
  // Points without a track of two leave no trace in the images either.
  for (auto point = model.points3D.begin(); point != model.points3D.end();) {
    if (point->second.track.size() >= 2) {
      double sum = 0;
      for (const ColmapTrackElement& element : point->second.track) {
        const SyntheticKeypoint& keypoint =
            turntable.images[element.image_id - 1].keypoints[element.point2D_idx];
        sum += (keypoint.xy - keypoint.exact_xy).norm();
      }
      point->second.error = sum / static_cast<double>(point->second.track.size());
      ++point;
      continue;
    }
    for (const ColmapTrackElement& element : point->second.track) {
      model.images[element.image_id].points2D[element.point2D_idx].point3D_id = kInvalidPoint3DId;
    }
    point = model.points3D.erase(point);
  }
  return model;
}

nlohmann::json RowMajor(const Eigen::Matrix4d& matrix) {
  nlohmann::json rows = nlohmann::json::array();
  for (int row = 0; row < 4; ++row) {
    rows.push_back({matrix(row, 0), matrix(row, 1), matrix(row, 2), matrix(row, 3)});
  }
  return rows;
}

nlohmann::json ImageJson(const View& view, const std::string& split) {
  const std::string stem = std::filesystem::path(view.name).stem().string();
  return {{"file", (split == "test" ? "images_test/" : "images/") + view.name},
          {"mask", "gt/masks/" + stem + ".png"},
          {"split", split},
          {"station", view.station},
          {"angle_deg", view.angle_deg},
          {"world_to_camera", RowMajor(view.cam_from_world.Matrix())},
          {"object_to_world", RowMajor(view.world_from_object.Matrix())}};
}

/// The station's direction from the table's middle, in the world.
nlohmann::json StationJson(const View& first_view) {
  const Eigen::Vector3d centre = CameraCentre(first_view.cam_from_world);
  const double degrees = 180 / kPi;
  return {{"index", first_view.station},
          {"elevation_deg", degrees * std::asin(centre.z() / centre.norm())},
          {"azimuth_deg", degrees * std::atan2(centre.x(), -centre.y())},
          {"distance", centre.norm()}};
}

}  // namespace

ColmapModel SyntheticObjectModel(const SyntheticTurntable& turntable, const Sim3& model_from_object) {
  return MakeModel(turntable, true, model_from_object);
}

ColmapModel SyntheticStaticModel(const SyntheticTurntable& turntable, const Sim3& model_from_world) {
  return MakeModel(turntable, false, model_from_world);
}

TurntableFile SyntheticTurntableFile(const SyntheticTurntable& turntable) {
  const TurntableScene& scene = turntable.scene;
  TurntableFile file;
  file.axis = scene.axis;
  file.num_stations = scene.num_stations;
  file.scale_observable = scene.scale_observable;
  file.units = scene.units;
  for (const View& view : scene.views) {
    TurntableImage image;
    image.name = view.name;
    image.station = view.station;
    image.angle_deg = view.angle_deg;
    image.world_from_object = view.world_from_object;
    file.images.push_back(image);
  }
  return file;
}

void WriteSyntheticWorkspace(const std::filesystem::path& workspace, const SyntheticTurntable& turntable,
                             ColmapFormat format) {
  CreateFolder(workspace / "sparse" / "0");
  CreateFolder(workspace / "sparse" / "static");
  WriteColmapModel(workspace / "sparse" / "0", SyntheticObjectModel(turntable), format);
  WriteColmapModel(workspace / "sparse" / "static", SyntheticStaticModel(turntable), format);
  WriteTurntableFile(workspace / "turntable.json", SyntheticTurntableFile(turntable));
}

nlohmann::json SyntheticSceneJson(const SyntheticTurntable& turntable, const std::vector<View>& test_views) {
  const SyntheticTurntableOptions& options = turntable.options;
  const Camera& camera = turntable.scene.cameras.front();
  const Eigen::Vector2d focal = FocalLengths(camera);
  const Eigen::Vector2d principal_point = PrincipalPoint(camera);
  const TurntableAxis& axis = turntable.scene.axis;
  const Shape& platter = turntable.platter;
  const double platter_z = platter.frame_from_shape.translation.z();
  nlohmann::json json = {{"scene", "synthetic"},
                         {"width", camera.width},
                         {"height", camera.height},
                         {"camera_model", InfoOf(camera.model).name},
                         {"fx", focal.x()},
                         {"fy", focal.y()},
                         {"cx", principal_point.x()},
                         {"cy", principal_point.y()},
                         {"pixel_convention", "COLMAP: the centre of the first pixel is (0.5, 0.5)"},
                         {"units", "metres"},
                         {"axis_point", {axis.point.x(), axis.point.y(), axis.point.z()}},
                         {"axis_direction", {axis.direction.x(), axis.direction.y(), axis.direction.z()}},
                         {"step_degrees", options.step_deg},
                         {"rotation_sense", "positive angle = right-handed about axis_direction"},
                         {"mask_values", {{"object", 255}, {"disc", 128}, {"static", 0}}},
                         {"disc",
                          {{"radius", platter.size.x()},
                           {"z_bottom", platter_z - platter.size.z()},
                           {"z_top", platter_z + platter.size.z()}}},
                         {"stations", nlohmann::json::array()},
                         {"images", nlohmann::json::array()}};
  if (!IsDistortionFree(camera)) json["camera_params"] = camera.params;
  int last_station = -1;
  for (const View& view : turntable.scene.views) {
    if (view.station != last_station) json["stations"].push_back(StationJson(view));
    last_station = view.station;
    json["images"].push_back(ImageJson(view, "train"));
  }
  for (const View& view : test_views) json["images"].push_back(ImageJson(view, "test"));
  return json;
}

void WriteSyntheticSceneJson(const std::filesystem::path& path, const SyntheticTurntable& turntable,
                             const std::vector<View>& test_views) {
  const nlohmann::json json = SyntheticSceneJson(turntable, test_views);
  WriteFileAtomically(path, [&json](std::ostream& stream) { stream << json.dump(1) << '\n'; });
}

}  // namespace s2gs
