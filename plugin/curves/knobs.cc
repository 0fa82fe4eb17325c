#include "plugin/curves/knobs.h"

#include <algorithm>

#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

Knob SplitKnob(std::string name, std::string what, std::string option, std::string from,
               std::vector<std::string> values) {
  return {std::move(name),
          std::move(what),
          KnobStage::kPoses,
          "motion_splitter",
          std::move(option),
          std::move(from),
          {"motion_splitter", "turntable_mapper"},
          std::move(values),
          {}};
}

Knob PoseKnob(std::string name, std::string what, std::string option, std::vector<std::string> values) {
  return {std::move(name),      std::move(what),   KnobStage::kPoses,
          "turntable_mapper",   std::move(option), "turntable_mapper",
          {"turntable_mapper"}, std::move(values), {}};
}

Knob TrainingKnob(std::string name, std::string what, std::string option, std::vector<std::string> values,
                  std::vector<std::pair<std::string, std::string>> fixed = {}) {
  return {std::move(name),      std::move(what),   KnobStage::kTraining,
          "gaussian_trainer",   std::move(option), "gaussian_trainer",
          {"gaussian_trainer"}, std::move(values), {},
          std::move(fixed)};
}

Knob MeshKnob(std::string name, std::string what, std::string option, std::vector<std::string> values) {
  return {std::move(name), std::move(what),   KnobStage::kMesh,
          "tsdf_mesher",   std::move(option), "tsdf_mesher",
          {"tsdf_mesher"}, std::move(values), {}};
}

std::vector<Knob> MakeKnobs() {
  return {
      SplitKnob("features", "features a photo", "SiftExtraction.max_num_features", "feature_extractor",
                {"1024", "2048", "4096", "8192", "16384", "32768"}),
      SplitKnob("pair_plan", "steps of the table up to which all pairs are matched", "Split.max_object_steps",
                "motion_splitter", {"1", "2", "3", "4", "6", "9"}),
      PoseKnob("joint_tolerance", "relative decrease at which the joint adjustment stops",
               "Joint.function_tolerance", {"1e-1", "1e-2", "1e-3", "1e-4", "1e-6", "1e-8", "1e-12"}),
      PoseKnob("joint_iterations", "most iterations of the joint adjustment in a round",
               "Joint.max_iterations", {"1", "2", "4", "8", "16", "32", "100"}),
      TrainingKnob("train_iterations", "iterations of training", "Train.num_iterations",
                   {"250", "500", "1000", "2000", "4000", "8000"}),
      TrainingKnob("photo_size", "longer side of the photos in training [px]", "max_image_size",
                   {"100", "200", "320", "480", "640", "960"}, {{"max_test_size", "1600"}}),
      TrainingKnob("max_gaussians", "most Gaussians", "Train.max_gaussians",
                   {"5000", "10000", "20000", "50000", "100000", "300000"}),
      TrainingKnob("local_consistency", "weight of local consistency", "Train.local_consistency_weight",
                   {"0", "0.01", "0.1", "1", "10", "50"}),
      TrainingKnob("entropy_3d", "weight of the entropy of p in space", "Train.entropy_3d_weight",
                   {"0", "0.01", "0.1", "1", "10"}),
      TrainingKnob("entropy_2d", "weight of the entropy of p in images", "Train.entropy_2d_weight",
                   {"0", "0.01", "0.1", "1", "10"}),
      TrainingKnob("normal", "weight of normals against depth", "Train.normal_weight",
                   {"0", "0.005", "0.02", "0.05", "0.15"}),
      TrainingKnob("distortion", "weight of depth distortion", "Train.distortion_weight",
                   {"0", "1", "10", "100", "1000"}),
      MeshKnob("voxel", "edge of a voxel [pixels on the surface]", "Tsdf.voxel_size_pixels",
               {"6", "4", "3", "2", "1.5", "1", "0.75"}),
      MeshKnob("refinement", "photos in which a vertex is compared", "Refine.num_views",
               {"3", "4", "6", "8", "12", "16"}),
  };
}

// The stage of a command whose option is no knob with a name.
struct CommandStage {
  const char* command;
  KnobStage stage;
  const char* from;
  std::vector<std::string> commands;
};

std::vector<CommandStage> CommandStages() {
  return {{"motion_splitter", KnobStage::kPoses, "motion_splitter", {"motion_splitter", "turntable_mapper"}},
          {"turntable_mapper", KnobStage::kPoses, "turntable_mapper", {"turntable_mapper"}},
          {"gaussian_trainer", KnobStage::kTraining, "gaussian_trainer", {"gaussian_trainer"}},
          {"gaussian_renderer", KnobStage::kMesh, "gaussian_renderer", {"gaussian_renderer", "tsdf_mesher"}},
          {"tsdf_mesher", KnobStage::kMesh, "tsdf_mesher", {"tsdf_mesher"}}};
}

}  // namespace

const std::vector<Knob>& AllKnobs() {
  static const std::vector<Knob> knobs = MakeKnobs();
  return knobs;
}

Knob FindKnob(const std::string& name) {
  std::string list;
  for (const Knob& knob : AllKnobs()) {
    if (knob.name == name) return knob;
    list += (list.empty() ? "" : ", ") + knob.name;
  }
  const size_t point = name.find('.');
  if (point != std::string::npos) {
    const std::string command = name.substr(0, point);
    for (const CommandStage& stage : CommandStages()) {
      if (command != stage.command) continue;
      const std::string option = name.substr(point + 1);
      return {name, option, stage.stage, command, option, stage.from, stage.commands, {}, {}};
    }
  }
  throw UserError("there is no knob \"" + name + "\". Take one of " + list +
                  ", or an option of a stage's command as COMMAND.OPTION, "
                  "e.g. tsdf_mesher.Tsdf.truncation_voxels");
}

KnobError ErrorOf(KnobStage stage, bool with_truth) {
  switch (stage) {
    case KnobStage::kPoses:
      return with_truth ? KnobError{"object_rot_deg.median", "rotation error of the poses, median [degrees]"}
                        : KnobError{"own_rotation_deg",
                                    "rotation of the poses against the longest run, "
                                    "median [degrees]"};
    case KnobStage::kTraining:
      return {"held_out_rmse", "RMS error of held-out photos [of 0 to 1]"};
    case KnobStage::kMesh:
      return with_truth
                 ? KnobError{"chamfer_pct.value", "Chamfer distance [% of the object's diameter]"}
                 : KnobError{"own_chamfer_pct", "Chamfer distance to the longest run [% of its diameter]"};
  }
  return {};
}

KnobError OwnErrorOf(KnobStage stage) {
  switch (stage) {
    case KnobStage::kPoses:
      return {"held_back_px", "RMS of each run's own matches held back from the adjustment [px]"};
    case KnobStage::kTraining:
      return ErrorOf(stage, false);
    case KnobStage::kMesh:
      return {"photo_disagreement", "1 - correlation of photos on the surface"};
  }
  return {};
}

}  // namespace s2gs
