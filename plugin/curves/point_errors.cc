#include "plugin/curves/point_errors.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <system_error>
#include <vector>

#include "mesh/surface/mesh_error.h"
#include "mesh/surface/triangle_mesh.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "sfm_split/scene/pose_error.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

constexpr uint64_t kMaxJsonBytes = uint64_t{1} << 28;
constexpr int64_t kSurfaceSamples = 100'000;

PoseMap ReadPoses(const fs::path& model) {
  PoseMap poses;
  for (const auto& [id, image] : ReadColmapModel(model).images) poses[image.name] = image.cam_from_world;
  return poses;
}

}  // namespace

std::map<std::string, double> EvaluatedFigures(const fs::path& json_path) {
  std::map<std::string, double> figures;
  std::error_code ec;
  if (!fs::is_regular_file(json_path, ec)) return figures;
  const Json json = Json::parse(ReadWholeFile(json_path, kMaxJsonBytes), nullptr, false);
  if (!json.is_object() || !json.contains("figures") || !json["figures"].is_object()) return figures;
  for (const auto& [name, figure] : json["figures"].items()) {
    if (!figure.is_object()) continue;
    for (const auto& [statistic, value] : figure.items()) {
      if (value.is_number()) figures[fmt::format("{}.{}", name, statistic)] = value.get<double>();
    }
  }
  return figures;
}

std::map<std::string, double> TrainingFigures(const Workspace& workspace) {
  std::map<std::string, double> figures;
  std::ifstream log(workspace.Log());
  std::string line;
  while (std::getline(log, line)) {
    const Json entry = Json::parse(line, nullptr, false);
    if (!entry.is_object() || entry.value("event", "") != "held_out") continue;
    figures.clear();
    for (const char* name :
         {"psnr_db", "ssim", "object_psnr_db", "object_ssim", "mask_iou", "count", "iteration"}) {
      if (entry.contains(name) && entry[name].is_number()) figures[name] = entry[name].get<double>();
    }
  }
  const auto psnr = figures.find("psnr_db");
  if (psnr != figures.end()) figures["held_out_rmse"] = std::pow(10, -psnr->second / 20);
  return figures;
}

std::map<std::string, double> OwnFigures(const Workspace& workspace) {
  std::map<std::string, double> figures;
  std::error_code ec;
  if (fs::is_regular_file(workspace.TurntableMapper(), ec)) {
    const Json json = Json::parse(ReadWholeFile(workspace.TurntableMapper(), kMaxJsonBytes), nullptr, false);
    const Json::json_pointer noise("/verdict/measured/held_back_noise_px");
    if (json.is_object() && json.contains(noise) && json[noise].is_number()) {
      figures["held_back_px"] = json[noise].get<double>();
    }
    const Json::json_pointer tilt("/sigma/axis_direction_deg");
    if (json.is_object() && json.contains(tilt) && json[tilt].is_number()) {
      figures["axis_sigma_deg"] = json[tilt].get<double>();
    }
  }
  std::ifstream log(workspace.MeshLog());
  for (std::string line; std::getline(log, line);) {
    const Json entry = Json::parse(line, nullptr, false);
    if (!entry.is_object() || !entry.contains("errors") || !entry["errors"].is_object()) continue;
    for (const auto& [name, error] : entry["errors"].items()) {
      if (error.is_number()) figures["photo_disagreement"] = error.get<double>();
    }
  }
  return figures;
}

std::map<std::string, double> PosesAgainst(const Workspace& workspace, const Workspace& reference) {
  try {
    const PoseMap own = ReadPoses(workspace.ObjectModel());
    const PoseMap other = ReadPoses(reference.ObjectModel());
    const PoseErrors errors = ComparePoses(own, other);
    if (errors.rotation_deg.empty()) return {};
    Eigen::Vector3d middle = Eigen::Vector3d::Zero();
    for (const auto& [name, pose] : other) middle += CameraCentre(pose) / static_cast<double>(other.size());
    std::vector<double> distances;
    for (const auto& [name, pose] : other) distances.push_back((CameraCentre(pose) - middle).norm());
    const double size = Summarize(distances).median;
    return {{"own_rotation_deg", Summarize(errors.rotation_deg).median},
            {"own_centre_pct", 100 * Summarize(errors.centre_length).median / size},
            {"own_images", static_cast<double>(errors.names.size()) / static_cast<double>(other.size())}};
  } catch (const UserError&) {
    return {};  // the run has no model
  }
}

std::map<std::string, double> MeshAgainst(const Workspace& workspace, const Workspace& reference) {
  try {
    const TriangleMesh own = ReadPlyMesh(workspace.TsdfMesh());
    const TriangleMesh other = ReadPlyMesh(reference.TsdfMesh());
    Eigen::AlignedBox3d box;
    for (const Eigen::Vector3f& vertex : other.vertices) box.extend(vertex.cast<double>().eval());
    TruthSurfaceOptions options;
    options.num_samples = kSurfaceSamples;
    const TruthSurface truth = MakeTruthSurface(other, {}, {}, {}, options);
    EstimatedSurface estimate;
    estimate.triangles = TrianglesInside(own, Sim3(), {});
    estimate.points = SampleSurface(own, kSurfaceSamples, 0, 1).points;
    const std::optional<SurfaceErrors> errors = CompareSurfaces(estimate, truth, {});
    if (!errors) return {};
    return {{"own_chamfer_pct", 100 * errors->chamfer_l1 / box.diagonal().norm()},
            {"triangles", static_cast<double>(own.triangles.size())}};
  } catch (const UserError&) {
    return {};  // the run has no mesh
  }
}

}  // namespace s2gs
