#include <fmt/format.h>

#include <algorithm>
#include <fstream>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <system_error>

#include "mesh/refine/mesh_refinement.h"
#include "plugin/cli/console_reporter.h"
#include "plugin/plan/plan_parts.h"
#include "plugin/plan/scan_plan.h"
#include "plugin/stage/json_file.h"
#include "plugin/stage/stage.h"
#include "s2gs/held_out_course.h"
#include "s2gs/image/photo_folder.h"
#include "s2gs/train_options.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/matching/weak_features.h"
#include "sfm_split/scene/camera_model.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "sfm_split/scene/io/turntable_file.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

// Null also where the file holds something else than an object.
Json ReadObject(const fs::path& path) {
  Json json = ReadJsonFile(path);
  return json.is_object() ? json : Json(nullptr);
}

// The last line of a log of one JSON object a line for which a predicate holds; null when there is none.
Json LastLine(const fs::path& path, const std::function<bool(const Json&)>& is_it) {
  std::ifstream log(path);
  Json last;
  for (std::string line; std::getline(log, line);) {
    Json entry = Json::parse(line, nullptr, false);
    if (entry.is_object() && is_it(entry)) last = std::move(entry);
  }
  return last;
}

// A number; `otherwise` where there is none.
double Number(const Json& object, const char* key, double otherwise = 0) {
  if (!object.is_object()) return otherwise;
  const auto found = object.find(key);
  return found != object.end() && found->is_number() ? found->get<double>() : otherwise;
}
std::string Text(const Json& object, const char* key) {
  if (!object.is_object()) return "";
  const auto found = object.find(key);
  return found != object.end() && found->is_string() ? found->get<std::string>() : "";
}

// What the stages left.
struct Evidence {
  Json labels, mapper, mesh;
  std::optional<TurntableFile> turntable;
  std::map<std::string, StageStatus> stages;
  fs::path log;

  bool HasRun(const std::string& stage) const {
    const auto found = stages.find(stage);
    return found != stages.end() &&
           (found->second.state == StageState::kDone || found->second.state == StageState::kForeign);
  }
  std::string Took(const std::string& stage) const {
    const auto found = stages.find(stage);
    if (found == stages.end() || !found->second.stamp) return "";
    return FormatDuration(found->second.stamp->seconds);
  }
};

Evidence Gather(const Workspace& workspace) {
  Evidence evidence;
  Reporter silent;  // the commands themselves say what is wrong
  std::error_code ec;
  if (!fs::is_directory(workspace.root, ec)) return evidence;
  for (StageStatus& status : CheckStages(workspace, silent)) {
    const std::string name = status.name;
    evidence.stages.emplace(name, std::move(status));
  }
  // What a stale stage left is no measurement of this scan.
  if (evidence.HasRun("motion_splitter")) evidence.labels = ReadObject(workspace.SplitLabels());
  if (evidence.HasRun("turntable_mapper")) evidence.mapper = ReadObject(workspace.TurntableMapper());
  if (evidence.HasRun("turntable_mapper")) {
    try {
      evidence.turntable = ReadTurntableFile(workspace.Turntable());
    } catch (const UserError&) {
      evidence.turntable.reset();
    }
  }
  if (evidence.HasRun("gaussian_trainer")) evidence.log = workspace.Log();
  if (evidence.HasRun("tsdf_mesher")) {
    evidence.mesh =
        LastLine(workspace.MeshLog(), [](const Json& line) { return Text(line, "event") == "refined"; });
  }
  return evidence;
}

std::string Stations(double count) { return fmt::format("{:.0f} station{}", count, count == 1 ? "" : "s"); }

void LeaveOut(PlanDecision* decision, std::string reason, std::string saving) {
  decision->state = PlanState::kLeftOut;
  decision->reason = std::move(reason);
  decision->saving = std::move(saving);
}
void Keep(PlanDecision* decision, std::string reason) {
  decision->state = PlanState::kRuns;
  decision->reason = std::move(reason);
}

// --- Each part: what decided it ---------------------------------------------------------------------------

void DecideMotion(const PlanRequest& request, const Evidence& /*evidence*/, PlanDecision* d) {
  if (request.has_masks) {
    LeaveOut(d, "masks say what turns", "the fits of several motions to each pair of photos");
  } else {
    Keep(d, "there are no masks");
  }
}

void DecideWeakFeatures(const PlanRequest& /*request*/, const Evidence& e, PlanDecision* d) {
  if (e.labels.is_null()) return;
  d->threshold = fmt::format("standard deviations lower by {:.0f} %, and photos that are joined no worse",
                             100 * kLeastFeatureGain);
  const double changing = Number(e.labels, "changing_features");
  const double found = Number(e.labels, "weak_features");
  if (changing > 0) {
    d->measured = fmt::format(
        "{:.0f} features a photo where things change, {:.0f} more at lower thresholds: standard "
        "deviations lower by {:.0f} %",
        changing, found, 100 * GainOfFeatures(changing, found));
    if (e.labels.value("takes_weak_features", Json()) == true)
      return Keep(d, "what it finds tells of the poses, too");
    return LeaveOut(d, "it finds too little, or the photos are joined worse with it",
                    "matching and adjusting what it finds");
  }
  d->measured = Text(e.labels, "reason");
  const std::string took = e.Took("feature_extractor");
  LeaveOut(d, "nothing is seen to change at a place of the camera",
           "a search at lower thresholds" + (took.empty() ? "" : "; the first one took " + took));
}

void DecidePairs(const PlanRequest& /*request*/, const Evidence& e, PlanDecision* d) {
  if (!e.labels.is_object() || !e.labels.value("pairs_matched", Json()).is_number()) return;
  if (!e.labels.at("images").is_array()) return;
  const double matched = Number(e.labels, "pairs_matched");
  const double photos = static_cast<double>(e.labels.at("images").size());
  const double all = photos * (photos - 1) / 2;
  d->measured = fmt::format("{:.0f} of {:.0f} pairs matched", matched, all);
  if (matched >= all) return Keep(d, "the scan is so small that all pairs are matched");
  const double saved = 100 * (1 - matched / all);
  if (saved < 0.5) return Keep(d, "nearly all pairs are matched");  // it would be called a saving of 0 %
  LeaveOut(d,
           "photos far apart on the table, or of stations that look at another side, have nothing in common",
           fmt::format("{:.0f} % of the matching", saved));
}

// What the photos show: the split says it first, and the mapper where it knows better.
std::string CaseOf(const Evidence& e) {
  const std::string placed = Text(e.mapper, "case");
  return placed.empty() ? Text(e.labels, "case") : placed;
}

void DecideTwoBodies(const PlanRequest& /*request*/, const Evidence& e, PlanDecision* d) {
  if (e.labels.is_null()) return;
  d->measured = Text(e.labels, "reason");
  if (CaseOf(e) == "one_body" || Text(e.mapper, "path") == "one body") {
    LeaveOut(d, "nothing turns: all photos show one rigid body",
             "the background's model, the axis, p and its terms in training");
  } else {
    Keep(d, "one part turns before another that stands still");
  }
}

// Whether circular motion was asked whether it does without the object's model, and whether it does.
bool WasAskedForCircle(const Evidence& e) {
  return e.mapper.is_object() && e.mapper.contains("circle_alone");
}
bool DoesWithoutObject(const Evidence& e) {
  return WasAskedForCircle(e) && Text(e.mapper, "circle_alone").empty();
}

void DecideFreeSfm(const PlanRequest& /*request*/, const Evidence& e, PlanDecision* d) {
  if (!e.mapper.is_object()) return;
  d->measured = Text(e.mapper, "circle_alone");
  d->threshold = "a place for all photos and a good verdict";
  if (!DoesWithoutObject(e)) {
    return Keep(d, WasAskedForCircle(e) ? "circular motion does not do without"
                                        : "circular motion was not asked whether it does without");
  }
  d->measured = Text(e.mapper, "path_reason");
  LeaveOut(d, "poses that circular motion leads to are good without it",
           "a run of colmap's mapper on one thread, and an adjustment of what it finds");
}

void DecideBackground(const PlanRequest& /*request*/, const Evidence& e, PlanDecision* d) {
  const std::string scene_case = CaseOf(e);
  if (scene_case.empty()) return;
  const bool is_as_split = scene_case == Text(e.labels, "case");
  d->measured = Stations(is_as_split ? Number(e.labels, "num_stations") : Number(e.mapper, "stations"));
  d->threshold = "2 stations whose photos of the background match";
  if (scene_case == "turntable" && (e.HasRun("background_mapper") || !e.HasRun("turntable_mapper"))) {
    return Keep(d, "several stations see the background from different places");
  }
  const std::string reason = scene_case == "one_body"         ? "everything is one body"
                             : scene_case == "single_station" ? "from one place its depth cannot be observed"
                                                              : "no two stations recognise it";
  LeaveOut(d, reason, "a run of colmap's mapper on one photo for each station");
}

void DecideScale(const PlanRequest& /*request*/, const Evidence& e, PlanDecision* d) {
  if (!e.turntable) return;
  d->measured = fmt::format("{}, scale {}", Stations(e.turntable->num_stations),
                            e.turntable->scale_observable ? "observed" : "not observable");
  d->threshold = "2 stations in different places";
  if (e.turntable->scale_observable) return Keep(d, "the stations fix it");
  LeaveOut(d, "one place, or one body, says nothing of it: it is 1 by definition",
           "one unknown of the adjustment that would have no bound");
}

void DecideFreeCameras(const PlanRequest& /*request*/, const Evidence& e, PlanDecision* d) {
  if (!e.mapper.is_object()) return;
  if (!e.mapper.contains("joint_model") || !e.mapper["joint_model"].is_object()) {
    if (Text(e.mapper, "path") == "one body") {
      Keep(d, "one body without a table has a pose for each photo");
    }
    return;
  }
  const Json& model = e.mapper["joint_model"];
  for (const Json& test : model.value("tests", Json::array())) {
    const bool is_fitted = test.is_object() && test.value("fitted", false);
    d->measured += fmt::format("{}{}: score {:.2f}{}", d->measured.empty() ? "" : "; ", Text(test, "general"),
                               Number(test, "score"),
                               is_fitted ? fmt::format(", BIC gain {:.1f}", Number(test, "bic_gain")) : "");
  }
  // As ModelTest::score and bic_gain say (joint_ba.h).
  d->threshold =
      "a score of 1.5 and of a third of what the Bayesian information criterion asks, then its gain above 0";
  const std::string chosen = Text(model, "chosen");
  if (chosen != "shared stations") return Keep(d, "the matches ask for it: " + chosen);
  LeaveOut(d, "the photos of a station agree on one pose",
           fmt::format("six unknowns for each of {:.0f} photos but one a station, and their adjustment",
                       Number(e.mapper, "registered")));
}

void DecideDoubtfulPoses(const PlanRequest& /*request*/, const Evidence& e, PlanDecision* d) {
  if (!e.mapper.is_object() || !e.mapper.contains("verdict")) return;
  const std::string verdict = Text(e.mapper["verdict"], "verdict");
  if (verdict.empty()) return;
  // As the scanner goes by (ScanSummary::PoseVerdict).
  const bool poses_hold = e.mapper["verdict"].value("poses_hold", verdict == "good");
  d->measured = "the poses are " + verdict;
  d->threshold = "good, or wrong in nothing but that a few photos have no place";
  if (poses_hold || d->is_forced) {
    return Keep(d, verdict == "good" ? "the poses are good: training is as usual"
                   : poses_hold      ? "the poses that there are hold"
                                     : "asked for");
  }
  LeaveOut(d, "a model of wrong poses is a wrong model", "training, rendering and the mesh");
}

void DecideDistortionChannel(const PlanRequest& /*request*/, const Evidence& /*evidence*/, PlanDecision* d) {
  const double weight = TrainOptions().distortion_weight;
  d->measured = fmt::format("weight {:g}", weight);
  d->threshold = "0";
  if (weight > 0) return Keep(d, "it has a weight");
  LeaveOut(d, "it has no weight: surfaces came out no better with it",
           "its sums in every pixel and their gradients");
}

// What training wrote down when it decided.
void DecideInTraining(const PlanRequest& /*request*/, const Evidence& e, PlanDecision* d) {
  if (e.log.empty()) return;
  const Json line = LastLine(e.log, [&](const Json& entry) {
    return Text(entry, "event") == "decision" && Text(entry, "part") == d->part;
  });
  if (line.is_null()) {
    if (d->part == "learning_p" && e.turntable && !TableTurns(*e.turntable)) {
      d->measured = "no photo's angle differs from another's";
      return LeaveOut(d, "nothing turns: there is one body", "p, its map and its three terms");
    }
    return Keep(d, d->part == "unseen_background" ? "every Gaussian shows in some photo"
                                                  : "training took no such decision");
  }
  d->measured = Text(line, "measured");
  d->threshold = Text(line, "threshold");
  if (line.value("left_out", false)) {
    LeaveOut(d, Text(line, "reason"), Text(line, "saving"));
  } else {
    Keep(d, Text(line, "reason"));
  }
}

void DecideUndistortion(const PlanRequest& request, const Evidence& e, PlanDecision* d) {
  if (!e.HasRun("turntable_mapper")) return;
  ColmapModel model;
  try {
    model = ReadColmapModel(request.workspace.ObjectModel());
  } catch (const UserError&) {
    return;
  }
  size_t num_pinholes = 0;
  for (const auto& [id, camera] : model.cameras) num_pinholes += IsDistortionFree(camera) ? 1 : 0;
  d->measured = fmt::format("{} of {} cameras have distortion", model.cameras.size() - num_pinholes,
                            model.cameras.size());
  d->threshold = "all distortion parameters are 0";
  if (num_pinholes < model.cameras.size()) return Keep(d, "lines that are straight are bent in the photos");
  LeaveOut(d, "the photos are those of a pinhole: they are copied",
           fmt::format("decoding, resampling and encoding of {} photos", model.images.size()));
}

void DecideBackgroundMaps(const PlanRequest& /*request*/, const Evidence& e, PlanDecision* d) {
  if (!e.turntable) return;
  if (!TableTurns(*e.turntable)) {
    d->measured = "one body";
    return LeaveOut(d, "what the photos do not look at is taken for background",
                    "its pixels in depth maps and fusion");
  }
  LeaveOut(d, "only what turns is wanted in the mesh", "its pixels in depth maps and fusion");
}

void DecideRefinement(const PlanRequest& /*request*/, const Evidence& e, PlanDecision* d) {
  if (!e.mesh.is_object()) return;
  const double photos = Number(e.mesh, "photos");
  const double vertices = Number(e.mesh, "vertices");
  const double share = vertices > 0 ? Number(e.mesh, "clear") / vertices : 0;
  d->measured = fmt::format("{:.0f} photos show the mesh, {:.1f} % of its vertices have a clear peak", photos,
                            100 * share);
  d->threshold =
      fmt::format("{} photos, {:.0f} %", kMinRefinementPhotos, MeshRefinementOptions().least_clear_pct);
  if (e.mesh.value("moved", false)) return Keep(d, "the photos' texture says where the surface is");
  if (Number(e.mesh, "shaded_vertices") > 0)
    return Keep(d, "hardly any vertex has texture, but light that stands still tells small forms");
  LeaveOut(d,
           !e.mesh.value("enabled", true)  ? "it was switched off"
           : photos < kMinRefinementPhotos ? "too few photos show the mesh"
                                           : "so few peaks may all be chance: no vertex moves",
           "the solution for the vertices' offsets");
}

using Decide = void (*)(const PlanRequest&, const Evidence&, PlanDecision*);

Decide DecisionOf(const std::string& part) {
  static const std::map<std::string, Decide> decisions = {
      {"motion", DecideMotion},
      {"weak_features", DecideWeakFeatures},
      {"pairs", DecidePairs},
      {"two_bodies", DecideTwoBodies},
      {"free_sfm", DecideFreeSfm},
      {"background", DecideBackground},
      {"scale", DecideScale},
      {"free_cameras", DecideFreeCameras},
      {"doubtful_poses", DecideDoubtfulPoses},
      {"distortion_channel", DecideDistortionChannel},
      {"sh_bands", DecideInTraining},
      {"learning_p", DecideInTraining},
      {"unseen_background", DecideInTraining},
      {"end_of_training", DecideInTraining},
      {"undistortion", DecideUndistortion},
      {"background_maps", DecideBackgroundMaps},
      {"refinement", DecideRefinement},
  };
  return decisions.at(part);
}

PlanStage StageOf(const StandardStage& stage, const PlanRequest& request, const Evidence& evidence) {
  PlanStage result{stage.name, "runs", "", 0};
  static const std::set<std::string> of_mesh = {"image_undistorter", "gaussian_renderer", "tsdf_mesher",
                                                "mesh_texturer"};
  std::string not_asked_by;
  if ((stage.name == "gaussian_trainer" && !request.trains) ||
      (of_mesh.count(stage.name) > 0 && !request.meshes))
    not_asked_by = "--until";
  else if (stage.name == "mesh_texturer" && !request.textures)
    not_asked_by = "--texture 0";
  const auto found = evidence.stages.find(stage.name);
  if (found != evidence.stages.end()) {
    const StageStatus& status = found->second;
    if (status.stamp) result.seconds = status.stamp->seconds;
    if (status.state == StageState::kDone) {
      result.state = "done";
      result.reason = "nothing that it depends on has changed";
    } else if (status.state == StageState::kForeign) {
      result.state = stage.name == "feature_extractor" ? "done" : "runs";
      result.reason = "its files are there, but this program did not make them";
    } else if (status.state == StageState::kStale) {
      result.reason = status.reason;
    }
  }
  if (!not_asked_by.empty() && result.state == "runs")
    result = {stage.name, "not asked for", not_asked_by, result.seconds};
  const bool is_needless =
      stage.name == "background_mapper" || (stage.name == "object_mapper" && DoesWithoutObject(evidence));
  if (result.state == "runs" && is_needless && evidence.HasRun("turntable_mapper")) {
    result = {stage.name, "left out", "the plan says why", 0};
  }
  if (result.state == "runs" && result.reason.empty()) result.reason = kNotDoneYet;
  return result;
}

}  // namespace

ScanPlan MakeScanPlan(const PlanRequest& request, Reporter& /*reporter*/) {
  ScanPlan plan;
  if (!request.image_path.empty()) {
    const PhotoFolder photos = InspectPhotoFolder(request.image_path);
    std::vector<double> megapixels;
    for (const PhotoFile& photo : photos.photos) {
      megapixels.push_back(1e-6 * photo.size.width * photo.size.height);
    }
    plan.num_photos = photos.photos.size();
    if (!megapixels.empty()) plan.megapixels = Summarize(megapixels).median;
  }
  const Evidence evidence = Gather(request.workspace);
  for (const StandardStage& stage : StandardStages(request.workspace)) {
    plan.stages.push_back(StageOf(stage, request, evidence));
  }
  for (const PlanPart& part : PlanParts()) {
    PlanDecision decision;
    decision.part = part.name;
    decision.is_forced = request.forced.count(part.name) > 0;
    try {
      DecisionOf(part.name)(request, evidence, &decision);
    } catch (const Json::exception&) {
      decision = {};  // a file that somebody changed: what it says is left out
      decision.part = part.name;
      decision.is_forced = request.forced.count(part.name) > 0;
    }
    if (decision.is_forced && decision.state == PlanState::kLeftOut) {
      Keep(&decision, "asked for; else it would be left out: " + decision.reason);
      decision.saving.clear();
    }
    if (decision.state == PlanState::kLater && decision.reason.empty()) {
      decision.reason = "can be decided after " + part.after;
    }
    plan.decisions.push_back(std::move(decision));
  }
  return plan;
}

}  // namespace s2gs
