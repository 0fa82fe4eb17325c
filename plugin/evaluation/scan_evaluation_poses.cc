#include <fmt/format.h>

#include <cmath>
#include <filesystem>
#include <map>
#include <set>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "plugin/evaluation/scan_evaluation.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "sfm_split/scene/io/turntable_file.h"
#include "sfm_split/scene/pose_error.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

// True centres nearer to each other than this share of the diameter are one place.
constexpr double kOnePlaceRatio = 1e-5;

std::string FileName(const std::string& image_name) { return fs::path(image_name).filename().string(); }

std::vector<std::pair<std::string, double>> MedianAndMax(const std::vector<double>& errors,
                                                         double factor = 1) {
  const Summary summary = Summarize(errors);
  return {
      {"median", factor * summary.median}, {"max", factor * summary.max}, {"mean", factor * summary.mean}};
}

// Poses by file name, or why there are none.
struct ModelPoses {
  PoseMap poses;
  std::string problem;
};

ModelPoses ReadPoses(const fs::path& folder, const std::string& name) {
  ModelPoses result;
  std::error_code ec;
  if (!fs::is_directory(folder, ec)) {
    result.problem = "no " + name;
    return result;
  }
  try {
    for (const auto& [id, image] : ReadColmapModel(folder).images) {
      if (!result.poses.emplace(FileName(image.name), image.cam_from_world).second) {
        throw UserError(folder, "has two images with the file name " + FileName(image.name), "");
      }
    }
  } catch (const UserError& error) {
    result.poses.clear();
    result.problem = error.what();
  }
  if (result.problem.empty() && result.poses.empty()) result.problem = name + " has no images";
  return result;
}

struct PoseFigureNames {
  std::string prefix;  // of the figures.
  std::string model;   // for messages.
  std::string frame;
};

// Rotation and centre errors, area under recall. Returns the fit, or the reason why there is none.
std::pair<Sim3Fit, std::string> AddPoseFigures(const PoseFigureNames& names, const ModelPoses& model,
                                               const PoseMap& truth, const PoseMap& train, double diameter,
                                               Figures* figures) {
  Figure rotation{
      names.prefix + "_rot_deg",
      "degrees",
      "rotation error of camera-from-" + names.frame + " after a Sim(3) fit of the camera centres",
      {},
      ""};
  Figure centre{names.prefix + "_centre_pct",
                "%",
                "camera centre error after the same fit, in % of the object's diameter",
                {},
                ""};
  Figure area{
      names.prefix + "_auc",
      "",
      "area under recall over relative pose error of all pairs of train images, up to 0.5, 1, 5 and 10 "
      "degrees",
      {},
      ""};
  PoseErrors errors;
  std::string problem = model.problem;
  if (problem.empty()) {
    errors = ComparePoses(model.poses, truth, kOnePlaceRatio * diameter);
    const FitStatus status = errors.truth_from_estimate.status;
    if (errors.names.empty()) {
      problem = "no image of " + names.model + " is in the ground truth";
    } else if (errors.names.size() == 1) {
      problem = "not measured: " + names.model + " has one image only";
    } else if (status != FitStatus::kOk) {
      problem = fmt::format("not measured: {} (of {} images)", Describe(status), errors.names.size());
    }
  }
  if (problem.empty()) {
    rotation.values = MedianAndMax(errors.rotation_deg);
    centre.values = MedianAndMax(errors.centre_length, 100 / diameter);
  }
  rotation.missing = centre.missing = problem;
  if (model.problem.empty() && train.size() >= 2) {
    const std::vector<double> relative = RelativePoseErrorsDeg(model.poses, train, kOnePlaceRatio * diameter);
    for (const auto& [text, threshold] :
         {std::pair("0.5", 0.5), std::pair("1", 1.0), std::pair("5", 5.0), std::pair("10", 10.0)}) {
      area.values.emplace_back(std::string("at_") + text, AreaUnderRecall(relative, threshold));
    }
  }
  area.missing = model.problem.empty() ? "fewer than two train images" : model.problem;
  for (Figure* figure : {&rotation, &centre, &area}) figures->push_back(std::move(*figure));
  return {errors.truth_from_estimate, problem};
}

void AddRegistered(const ModelPoses& model, const std::string& name, const std::string& model_name,
                   const PoseMap& train, Figures* figures) {
  Figure figure{name, "images", "train images with a pose in " + model_name, {}, model.problem};
  if (model.problem.empty()) {
    double count = 0;
    for (const auto& [image, pose] : train) count += model.poses.count(image) > 0 ? 1 : 0;
    figure.values = {{"value", count}, {"of", static_cast<double>(train.size())}};
  }
  figures->push_back(std::move(figure));
}

void AddAxisFigures(const std::string& prefix, const std::string& model, const TurntableFile* turntable,
                    const std::string& turntable_problem, const Sim3Fit& fit, const std::string& fit_problem,
                    const ScanTruth& truth, Figures* figures) {
  Figure direction{prefix + "_deg",
                   "degrees",
                   "angle between the estimated and the true axis, aligned by " + model,
                   {},
                   ""};
  Figure offset{prefix + "_offset_pct",
                "%",
                "distance of the true axis point from the estimated axis, aligned by " + model +
                    ", in % of the object's diameter",
                {},
                ""};
  if (turntable != nullptr && fit.status == FitStatus::kOk) {
    const AxisError error = CompareAxes(turntable->axis, truth.scene.axis, fit.b_from_a);
    direction.values = {{"value", error.direction_deg}};
    offset.values = {{"value", 100 / truth.diameter * error.offset}};
  }
  direction.missing = offset.missing = turntable == nullptr ? turntable_problem : fit_problem;
  figures->push_back(std::move(direction));
  figures->push_back(std::move(offset));
}

void AddAngleFigures(const TurntableFile* turntable, const std::string& problem, const SceneTruth& truth,
                     Figures* figures) {
  Figure angle{"angle_deg",
               "degrees",
               "turntable angle error of the train images after removing the mean offset",
               {},
               problem};
  Figure images{"angle_images", "images", "train images with an angle in turntable.json", {}, problem};
  if (turntable != nullptr) {
    std::map<std::string, Eigen::Quaterniond> estimated;
    for (const TurntableImage& image : turntable->images) {
      estimated[FileName(image.name)] = image.world_from_object.rotation;
    }
    std::vector<Eigen::Quaterniond> estimated_turns;
    std::vector<Eigen::Quaterniond> true_turns;
    double num_train = 0;
    for (const SceneTruthImage& image : truth.images) {
      if (!image.is_train) continue;
      ++num_train;
      const auto found = estimated.find(image.name);
      if (found == estimated.end()) continue;
      estimated_turns.push_back(found->second);
      true_turns.push_back(image.world_from_object.rotation);
    }
    images.values = {{"value", static_cast<double>(true_turns.size())}, {"of", num_train}};
    const std::vector<double> errors =
        TurntableAngleErrorsDeg(estimated_turns, true_turns, truth.axis.direction);
    if (errors.empty()) {
      angle.missing = "not measured: fewer than two train images in turntable.json";
    } else {
      angle.values = MedianAndMax(errors);
    }
  }
  figures->push_back(std::move(angle));
  figures->push_back(std::move(images));
}

}  // namespace

ScanTruth ReadScanTruth(const fs::path& scene_folder) {
  ScanTruth truth;
  truth.scene = ReadSceneTruth(scene_folder);
  truth.object = ReadPlyMesh(truth.scene.ObjectMeshPath());
  std::error_code ec;
  if (fs::exists(truth.scene.DiscMeshPath(), ec)) truth.disc = ReadPlyMesh(truth.scene.DiscMeshPath());
  Eigen::AlignedBox3d bounds;
  for (const Eigen::Vector3f& vertex : truth.object.vertices) bounds.extend(vertex.cast<double>());
  truth.diameter = truth.object.vertices.empty() ? 0 : bounds.diagonal().norm();
  if (!(truth.diameter > 0)) {
    throw UserError(truth.scene.ObjectMeshPath(), "has no extent",
                    "It must be the true surface of the object");
  }
  return truth;
}

ScanAlignment EvaluatePoses(const Workspace& workspace, const ScanTruth& truth, Figures* figures) {
  PoseMap object_truth, static_truth, object_train, static_train;
  for (const SceneTruthImage& image : truth.scene.images) {
    object_truth[image.name] = image.CamFromObject();
    static_truth[image.name] = image.cam_from_world;
    if (!image.is_train) continue;
    object_train[image.name] = image.CamFromObject();
    static_train[image.name] = image.cam_from_world;
  }
  const ModelPoses object_model = ReadPoses(workspace.ObjectModel(), "sparse/0");
  AddRegistered(object_model, "registered", "sparse/0", object_train, figures);
  const auto [object_fit, object_problem] = AddPoseFigures(
      {"object", "sparse/0", "object"}, object_model, object_truth, object_train, truth.diameter, figures);
  const ModelPoses static_model = ReadPoses(workspace.StaticModel(), "sparse/static");
  AddRegistered(static_model, "static_registered", "sparse/static", static_train, figures);
  const auto [static_fit, static_problem] =
      AddPoseFigures({"static", "sparse/static", "world"}, static_model, static_truth, static_train,
                     truth.diameter, figures);

  TurntableFile turntable;
  std::string turntable_problem;
  std::error_code ec;
  if (!fs::exists(workspace.Turntable(), ec)) {
    turntable_problem = "no turntable.json";
  } else {
    try {
      turntable = ReadTurntableFile(workspace.Turntable());
    } catch (const UserError& error) {
      turntable_problem = error.what();
    }
  }
  const TurntableFile* readable = turntable_problem.empty() ? &turntable : nullptr;
  AddAngleFigures(readable, turntable_problem, truth.scene, figures);
  // The axis is the same line in the world and, at every turn, in the object's frame.
  const bool has_axis = truth.scene.AxisIsFixedInObject();
  AddAxisFigures("axis", "sparse/0", has_axis ? readable : nullptr,
                 has_axis ? turntable_problem : "not measured: the object was laid down in several ways",
                 object_fit, object_problem, truth, figures);
  AddAxisFigures("static_axis", "sparse/static", readable, turntable_problem, static_fit, static_problem,
                 truth, figures);

  Figure scale{"scale_err_pct", "%", "|object scale / background scale - 1|, from the two fits", {}, ""};
  if (object_fit.HasScale() && static_fit.HasScale()) {
    scale.values = {{"value", 100 * std::abs(object_fit.b_from_a.scale / static_fit.b_from_a.scale - 1)}};
  }
  scale.missing = object_fit.HasScale() ? static_problem : object_problem;
  figures->push_back(std::move(scale));

  ScanAlignment alignment;
  if (object_fit.status == FitStatus::kOk) alignment.truth_from_object = object_fit.b_from_a;
  alignment.reason = object_problem;
  return alignment;
}

}  // namespace s2gs
