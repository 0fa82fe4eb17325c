#include "plugin/plan/plan_parts.h"

#include <fmt/format.h>

#include "plugin/cli/options.h"

namespace s2gs {
namespace {

// More than any scan has.
constexpr char kAllPhotos[] = "1000000";

std::vector<PlanPart> MakeParts() {
  return {
      {"motion", "telling what turns by its motion", "motion_splitter", "", "automatic_scanner", {}},
      {"weak_features",
       "a second search for features, where things change",
       "motion_splitter",
       "motion_splitter",
       "motion_splitter",
       {{"weak_features_always", "1"}}},
      {"pairs",
       "matching every photo with every other",
       "motion_splitter",
       "motion_splitter",
       "motion_splitter",
       {{"Split.max_object_steps", kAllPhotos},
        {"Split.station_partners", kAllPhotos},
        {"Split.max_nearby_stations", kAllPhotos}}},
      {"two_bodies",
       "the split into two bodies",
       "motion_splitter",
       "motion_splitter",
       "",
       {},
       "where nothing turns, a second body has no photos; masks (--mask_path) say what turns where this is "
       "wrong"},
      {"free_sfm",
       "the object's model, which poses are found from",
       "object_mapper",
       "turntable_mapper",
       "turntable_mapper",
       {{"circle_first", "0"}}},
      {"background",
       "the background's model",
       "background_mapper",
       "motion_splitter",
       "",
       {},
       "photos from one place, or that no other station matches, leave nothing to triangulate"},
      {"scale",
       "the scale between both models",
       "turntable_mapper",
       "turntable_mapper",
       "",
       {},
       "with one place, or one body, every scale explains the photos equally well"},
      {"free_cameras",
       "a pose for each photo instead of one for each station",
       "turntable_mapper",
       "turntable_mapper",
       "turntable_mapper",
       {{"Joint.model", "free_cameras"}}},
      {"doubtful_poses",
       "training on poses that are not good",
       "gaussian_trainer",
       "turntable_mapper",
       "automatic_scanner",
       {}},
      {"distortion_channel",
       "the map of depth distortion and its term",
       "gaussian_trainer",
       "",
       "gaussian_trainer",
       {{"Train.distortion_weight", "100"}}},
      {"sh_bands",
       "bands of colour that no photo tells",
       "gaussian_trainer",
       "gaussian_trainer",
       "gaussian_trainer",
       {{"Train.only_told_bands", "0"}}},
      {"learning_p",
       "learning which body a Gaussian belongs to",
       "gaussian_trainer",
       "gaussian_trainer",
       "gaussian_trainer",
       {{"Train.settle_from", "1"}, {"Train.settle_until", "1"}}},
      {"unseen_background",
       "Gaussians of the background that no photo shows",
       "gaussian_trainer",
       "gaussian_trainer",
       "gaussian_trainer",
       {{"Train.unseen_static_weight", "0"}}},
      {"end_of_training",
       "the end of training, once the error of held-out photos has stopped falling",
       "gaussian_trainer",
       "gaussian_trainer",
       "gaussian_trainer",
       {{"Train.stop_gain_pct", "0"}}},
      {"undistortion",
       "resampling the photos as a pinhole sees them",
       "image_undistorter",
       "turntable_mapper",
       "gaussian_renderer",
       {{"undistort_always", "1"}}},
      {"background_maps",
       "the background in depth maps and mesh",
       "gaussian_renderer",
       "gaussian_trainer",
       "gaussian_renderer",
       {{"maps_of", "all"}}},
      {"refinement",
       "moving the mesh to where photos agree",
       "tsdf_mesher",
       "tsdf_mesher",
       "tsdf_mesher",
       {{"Refine.enabled", "1"}, {"Refine.least_clear_pct", "0"}}},
  };
}

}  // namespace

const std::vector<PlanPart>& PlanParts() {
  static const std::vector<PlanPart> parts = MakeParts();
  return parts;
}

std::set<std::string> ForcedParts(const std::vector<std::string>& names) {
  std::set<std::string> forced;
  for (const std::string& name : names) {
    if (name.empty() || name == "0") continue;
    bool is_known = false;
    std::string list;
    for (const PlanPart& part : PlanParts()) {
      const bool is_it = part.name == name || (name == "1" && part.name == "doubtful_poses");
      if (is_it && !part.CanBeForced()) {
        throw CommandLineError(
            fmt::format("--force {}: {} cannot be forced: {}", name, part.what, part.never_forced));
      }
      const bool is_stage_of_it = part.stage == name && part.CanBeForced() && part.name != "doubtful_poses";
      if (is_it || is_stage_of_it) forced.insert(part.name);
      is_known = is_known || is_it || is_stage_of_it;
      if (part.CanBeForced()) list += (list.empty() ? "" : ", ") + part.name;
    }
    if (!is_known) {
      throw CommandLineError(
          fmt::format("--force {} is none of 0, 1, {}, nor a stage that has one of these", name, list));
    }
  }
  return forced;
}

std::vector<std::string> ForcedArguments(const std::string& command, const std::set<std::string>& parts) {
  std::vector<std::string> arguments;
  for (const PlanPart& part : PlanParts()) {
    if (part.command != command || parts.count(part.name) == 0) continue;
    for (const auto& [option, value] : part.forced_by) {
      arguments.push_back("--" + option);
      arguments.push_back(value);
    }
  }
  return arguments;
}

}  // namespace s2gs
