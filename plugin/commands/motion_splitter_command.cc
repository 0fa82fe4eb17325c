#include "plugin/commands/motion_splitter_command.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <map>
#include <optional>
#include <ostream>
#include <string>
#include <utility>
#include <vector>

#include "plugin/colmap/extract_features.h"
#include "plugin/outputs/split_files.h"
#include "plugin/outputs/split_overlay.h"
#include "plugin/outputs/split_pictures.h"
#include "plugin/stage/stage.h"
#include "plugin/stage/workspace.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/keeping_reporter.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/split/motion_split.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

struct Settings {
  fs::path database_path;
  fs::path output_path;
  fs::path mask_path;
  fs::path colmap_path;
  FeatureExtraction extraction;
  int max_overlays = 20;
  bool use_matches = false;
  bool weak_features = true;
  bool weak_features_always = false;
  SplitSettings split;
};

void AddOptions(Options& options, Settings* settings) {
  options
      .Add("database_path", &settings->database_path,
           "COLMAP's database with the features of all photos; made when it is missing, else only read")
      .Required();
  options.Add("output_path", &settings->output_path,
              "folder for object.db, static.db and labels.json; empty: split, beside the database");
  options.Add(
      "image_path", &settings->extraction.image_path,
      "the photos: to extract features where the database has none, to see where the camera stood still "
      "and what changes, and for overlays");
  options.Add("colmap_path", &settings->colmap_path,
              "the colmap executable or its folder; empty: searched for on PATH");
  options.Add("max_overlays", &settings->max_overlays,
              "photos, spread evenly, whose keypoints are drawn by label in overlays/, given --image_path");
  options.Add(
      "mask_path", &settings->mask_path,
      "masks of the rotating part, named as automatic_scanner has it (a.jpg.png for a.jpg); empty: it is "
      "found by its motion");
  options.Add(
      "use_matches", &settings->use_matches,
      "take the raw matches that the database has already (of colmap exhaustive_matcher, say), of all "
      "its pairs, instead of planning pairs and matching them");
  options.Add(
      "weak_features", &settings->weak_features,
      "look again at lower thresholds where things change, given --image_path, and take what is found "
      "where that lowers standard deviations");
  options.Add("weak_features_always", &settings->weak_features_always,
              "take it even where it lowers them by less than 1 %, or joins the photos worse");
  AddFeatureExtractionOptions(options, &settings->extraction);
  auto station =
      options.Group("Station", &settings->split.station, "what counts as a camera that stands still");
  station.Add("max_unmoved_px", &StationOptions::max_unmoved_px, "a match that moves by no more is unmoved")
      .Unit("px");
  station.Add("max_shake_px", &StationOptions::max_shake_px, "largest shake of the tripod between two photos")
      .Unit("px");
  auto match =
      options.Group("SiftMatching", &settings->split.match, "which features match, as COLMAP names it");
  match.Add("max_ratio", &DescriptorMatchOptions::max_ratio, "best over second best distance of a match");
  match.Add("max_distance", &DescriptorMatchOptions::max_distance, "largest distance of a match")
      .Unit("radians");
  match.Add("cross_check", &DescriptorMatchOptions::cross_check, "matches must be mutual");
  auto motion = options.Group("TwoViewMotion", &settings->split.motion,
                              "which matches of two photos are of one motion");
  motion.Add("max_error_px", &TwoViewMotionOptions::max_error_px, "largest epipolar error of an inlier")
      .Unit("px");
  auto split = options.Group("Split", &settings->split.split, "which pairs of photos are matched");
  split.Add(
      "max_object_steps", &MotionSplitOptions::max_object_steps,
      "steps of the table up to which all pairs within a station are matched; beyond, ever more sparsely");
  split.Add("station_partners", &MotionSplitOptions::station_partners,
            "best partners of a photo in every other station that it is matched with, with their neighbours");
  split.Add("max_nearby_stations", &MotionSplitOptions::max_nearby_stations,
            "other stations that a station's photos are matched with");
  split.Add("max_exhaustive_pairs", &MotionSplitOptions::max_exhaustive_pairs,
            "pairs up to which photos without stations are all matched with one another");
}

struct Paths {
  fs::path root;    // where the stages' stamps lie
  fs::path output;  // where the results go
};

// The options that change the features, and those that change the split.
std::map<std::string, std::string> FeatureOptions(const Options& options) {
  std::map<std::string, std::string> values = options.Values("SiftExtraction");
  values.merge(options.Values("ImageReader"));
  return values;
}

std::map<std::string, std::string> SplitOptions(const Options& options) {
  std::map<std::string, std::string> values = options.Values();
  for (const auto& [name, value] : FeatureOptions(options)) values.erase(name);
  for (const char* name : {"database_path", "output_path", "image_path", "mask_path", "colmap_path"})
    values.erase(name);
  return values;
}

void PrintSummary(const MotionSplit& split, const SplitFeatures& features, std::ostream& out) {
  size_t largest = 0;
  for (const std::vector<int>& station : split.stations.images) largest = std::max(largest, station.size());
  std::vector<size_t> count(3, 0);
  for (const auto& labels : split.labels) {
    for (const KeypointLabel label : labels) ++count[static_cast<size_t>(label)];
  }
  const auto num = static_cast<double>(features.images.size());
  const double all = std::max<double>(1, static_cast<double>(count[0] + count[1] + count[2]));
  out << "case                " << CaptureCaseName(split.capture_case) << '\n'
      << "because             " << split.reason << '\n'
      << "photos              " << features.images.size() << '\n'
      << "stations            " << split.stations.images.size() << ", the largest of " << largest
      << " photos\n"
      << "pairs matched       " << split.num_pairs_matched << " of "
      << features.images.size() * (features.images.size() - 1) / 2 << '\n'
      << "object pairs        " << split.object_pairs.size() << ", which join " << split.ringed_photos
      << " of " << split.station_photos << " photos in rings\n"
      << "background pairs    " << split.static_pairs.size() << '\n';
  const std::array<const char*, 3> names = {"unknown keypoints   ", "static keypoints    ",
                                            "rotating keypoints  "};
  for (const size_t label : {2, 1, 0}) {
    out << names[label] << count[label] << ", " << std::lround(static_cast<double>(count[label]) / num)
        << " a photo, " << std::lround(100 * static_cast<double>(count[label]) / all) << " %\n";
  }
}

// Weak features are placed nearly as exactly as the others, so that every one of them tells of the poses.
// Only scans whose photos they join worse do without. Where no pair of photos is verified with or without
// them, the circle is found from raw matches, of which they give more.
void TakeWeakFeatures(const Settings& settings, const SplitSettings& split_settings,
                      const GivenMatches& given, const ScanPictures& pictures, Reporter& reporter,
                      SplitFeatures* features, MotionSplit* split) {
  const bool may_add = settings.weak_features && !settings.use_matches && settings.mask_path.empty();
  const bool is_always = settings.weak_features_always;
  if ((!split->has_changes && !is_always) || !may_add) return;
  SplitFeatures with_weak = *features;
  const int64_t added = AddWeakFeatures(settings.extraction.image_path, pictures,
                                        split->lacks_features || is_always, &with_weak, reporter);
  features->changing = with_weak.changing;
  features->found = with_weak.found;
  if (added <= 0) return;
  MotionSplit again = SplitMotion(with_weak.images, split_settings, &reporter, given, &pictures);
  const auto joined = [](const MotionSplit& s) {
    return std::make_pair(s.ringed_photos, s.object_pairs.size());
  };
  reporter.Debug("photos that pairs join in rings: " + std::to_string(split->ringed_photos) +
                 ", with weak features " + std::to_string(again.ringed_photos) + " of " +
                 std::to_string(again.station_photos));
  if (is_always || joined(again) >= joined(*split)) {
    *features = std::move(with_weak);
    *split = std::move(again);
  }
}

void WriteSplit(const Settings& settings, const Paths& paths, const SplitFeatures& features,
                const MotionSplit& split, const std::optional<ScanPictures>& pictures, Reporter& reporter) {
  CreateFolder(paths.output);
  RemoveStaleTemporaries(paths.output);
  KeepingReporter of_background(reporter);
  ParallelFor(2, 0, [&](int64_t body) {
    if (body == 0) {
      WriteSplitDatabase(settings.database_path, paths.output / "object.db", features, split.object_pairs,
                         split.object_matches, reporter);
    } else {
      WriteSplitDatabase(settings.database_path, paths.output / "static.db", features, split.static_pairs,
                         split.static_matches, of_background);
    }
  });
  for (const auto& [level, message] : of_background.messages()) reporter.Log(level, message);
  WriteLabels(paths.output / "labels.json", split, features);
  if (pictures) {
    WriteChangeMaps(paths.output / "changes", settings.extraction.image_path, pictures->changes, features);
  }
  if (settings.max_overlays > 0 && !settings.extraction.image_path.empty()) {
    WriteSplitOverlays(paths.output / "overlays", settings.extraction.image_path, features, split,
                       settings.max_overlays, reporter);
  }
}

void Split(const Settings& settings, const Paths& paths, std::ostream& out, Reporter& reporter) {
  SplitFeatures features = ReadSplitFeatures(settings.database_path);
  reporter.Info(std::to_string(features.images.size()) + " photos read from " +
                settings.database_path.string());
  SplitSettings split_settings = settings.split;
  std::optional<ScanPictures> pictures;
  if (!settings.extraction.image_path.empty()) {
    pictures = ReadScanPictures(settings.extraction.image_path, features, split_settings.station, reporter);
    if (pictures) TakeOrderOfCapture(split_settings.station, &*pictures, &features, reporter);
  }
  if (!settings.mask_path.empty()) ApplyMasks(settings.mask_path, &features, reporter);
  GivenMatches given;
  if (settings.use_matches) {
    given = ReadGivenMatches(settings.database_path, features);
    const int all = static_cast<int>(features.images.size());
    split_settings.split.max_object_steps = all;
    split_settings.split.station_partners = all;
    split_settings.split.max_nearby_stations = all;
  }
  const ScanPictures* seen = pictures ? &*pictures : nullptr;
  MotionSplit split = SplitMotion(features.images, split_settings, &reporter, given, seen);
  if (pictures) TakeWeakFeatures(settings, split_settings, given, *pictures, reporter, &features, &split);
  for (const std::string& warning : split.warnings) reporter.Warn(warning);
  AppendStationFeatures(&split, &features);

  WriteSplit(settings, paths, features, split, pictures, reporter);
  PrintSummary(split, features, out);
  out << "written to          " << paths.output.string() << '\n';
}

}  // namespace

void RunMotionSplitter(CommandContext& context) {
  Settings settings;
  Options& options = context.Declare(
      "Splits the features of turntable photos into what stands still and what turns, without masks: "
      "extracts "
      "features with `colmap` if that was not done, matches the photos by itself and writes two databases "
      "for "
      "`colmap mapper`, one for each part. Keypoint indices stay those of the database given.",
      "--database_path scan/database.db --image_path scan/images");
  AddOptions(options, &settings);
  Reporter& reporter = context.Parse();
  Paths paths;
  paths.root = settings.output_path.empty() ? settings.database_path.parent_path() : settings.output_path;
  if (paths.root.empty()) paths.root = ".";
  paths.output = settings.output_path.empty() ? paths.root / "split" : settings.output_path;
  CreateFolder(paths.root);
  const Workspace workspace{paths.root};
  StageRunner runner(workspace, reporter);

  FeatureExtraction& extraction = settings.extraction;
  extraction.database_path = settings.database_path;
  std::vector<std::string> depends_on;
  if (!extraction.image_path.empty()) {
    RunFeatureStage(extraction, settings.colmap_path, FeatureOptions(options), workspace, &runner, reporter);
    depends_on.emplace_back("feature_extractor");
  } else if (NeedsFeatures(settings.database_path)) {
    throw UserError(settings.database_path, "has no features",
                    "Give --image_path, the folder of the photos, to extract them");
  }

  Stage stage{"motion_splitter", {settings.database_path}, SplitOptions(options), {}, depends_on};
  for (const fs::path& photos : {extraction.image_path, settings.mask_path}) {
    if (!photos.empty()) stage.inputs.push_back(photos);
  }
  stage.outputs = {paths.output / "object.db", paths.output / "static.db", paths.output / "labels.json"};
  stage.also_writes = {paths.output};
  const bool has_run = runner.Run(stage, [&] { Split(settings, paths, context.out(), reporter); });
  if (!has_run) context.out() << "up to date: " << paths.output.string() << '\n';
}

}  // namespace s2gs
