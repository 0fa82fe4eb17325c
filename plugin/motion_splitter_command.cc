#include "plugin/motion_splitter_command.h"

#include <filesystem>
#include <string>
#include <vector>

#include "plugin/split_files.h"
#include "sfm_split/error.h"
#include "sfm_split/file_io.h"
#include "sfm_split/motion_split.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

struct Settings {
  fs::path database_path;
  fs::path output_path;
  fs::path mask_path;
  bool write_matches = true;
  SplitSettings split;
};

void AddOptions(Options& options, Settings* settings) {
  options
      .Add("database_path", &settings->database_path,
           "COLMAP's database with the features of all photos; it is only read")
      .Required();
  options.Add("output_path", &settings->output_path,
              "folder for object.db, static.db and labels.json; empty: split, beside the database");
  options.Add("mask_path", &settings->mask_path,
              "masks of the rotating part, COLMAP's names (a.jpg.png); empty: it is found by its motion");
  options.Add("write_matches", &settings->write_matches, "keep the raw matches in both databases");
  auto station = options.Group("Station", &settings->split.station);
  station.Add("max_unmoved_px", &StationOptions::max_unmoved_px, "a match that moves by no more is unmoved")
      .Unit("px");
  station.Add("max_shake_px", &StationOptions::max_shake_px, "largest shake of the tripod between two photos")
      .Unit("px");
  station.Add("min_unmoved_matches", &StationOptions::min_unmoved_matches,
              "fewest unmoved matches of two photos from one station");
  station.Add("min_unmoved_share", &StationOptions::min_unmoved_share, "their smallest share of the matches");
  station.Add("min_cells", &StationOptions::min_cells,
              "cells of an 8 x 8 grid over the photo that they must fill");
  auto match = options.Group("SiftMatching", &settings->split.match);
  match.Add("max_ratio", &DescriptorMatchOptions::max_ratio, "best over second best distance of a match");
  match.Add("max_distance", &DescriptorMatchOptions::max_distance, "largest distance of a match")
      .Unit("radians");
  match.Add("cross_check", &DescriptorMatchOptions::cross_check, "matches must be mutual");
  auto motion = options.Group("TwoViewMotion", &settings->split.motion);
  motion.Add("max_error_px", &TwoViewMotionOptions::max_error_px, "largest epipolar error of an inlier")
      .Unit("px");
  motion.Add("confidence", &TwoViewMotionOptions::confidence, "of the robust fit");
  motion.Add("max_iterations", &TwoViewMotionOptions::max_iterations, "of the robust fit");
  motion.Add("min_inliers", &TwoViewMotionOptions::min_inliers, "fewest matches that make a motion");
  auto split = options.Group("Split", &settings->split.split);
  split.Add("min_static_support", &MotionSplitOptions::min_static_support,
            "photos of its station that must show a keypoint unmoved before it is background");
  split.Add("min_moved_px", &MotionSplitOptions::min_moved_px, "smallest move that shows the table turning")
      .Unit("px");
  split.Add("max_object_steps", &MotionSplitOptions::max_object_steps,
            "steps of the table up to which all pairs within a station are matched; beyond, ever more sparsely");
  split.Add("station_partners", &MotionSplitOptions::station_partners,
            "best partners of a photo in every other station that it is matched with, with their neighbours");
  split.Add("max_nearby_stations", &MotionSplitOptions::max_nearby_stations,
            "other stations that a station's photos are matched with");
  split.Add("min_rotating_matches", &MotionSplitOptions::min_rotating_matches,
            "verified matches that make a keypoint rotating");
  split.Add("max_exhaustive_pairs", &MotionSplitOptions::max_exhaustive_pairs,
            "pairs up to which photos without stations are all matched with one another");
}

}  // namespace

void RunMotionSplitter(CommandContext& context) {
  Settings settings;
  Options& options = context.Declare(
      "Splits the features of turntable photos into what stands still and what turns, without masks: matches "
      "the photos by itself and writes two databases for `colmap mapper`, one for each part. Keypoint "
      "indices "
      "stay those of the database given.",
      "--database_path scan/database.db");
  AddOptions(options, &settings);
  Reporter& reporter = context.Parse();
  const fs::path output =
      settings.output_path.empty() ? settings.database_path.parent_path() / "split" : settings.output_path;

  SplitFeatures features = ReadSplitFeatures(settings.database_path);
  reporter.Info(std::to_string(features.images.size()) + " images read from " +
                settings.database_path.string());
  if (!settings.mask_path.empty()) ApplyMasks(settings.mask_path, &features, reporter);
  const MotionSplit split = SplitMotion(features.images, settings.split, &reporter);
  reporter.Info(std::string(CaptureCaseName(split.capture_case)) + ": " + split.reason);
  for (const std::string& warning : split.warnings) reporter.Warn(warning);

  CreateFolder(output);
  RemoveStaleTemporaries(output);
  WriteSplitDatabase(settings.database_path, output / "object.db", features, split.object_pairs,
                     settings.write_matches ? &split.object_matches : nullptr, reporter);
  WriteSplitDatabase(settings.database_path, output / "static.db", features, split.static_pairs,
                     settings.write_matches ? &split.static_matches : nullptr, reporter);
  WriteLabels(output / "labels.json", split, features);

  std::vector<size_t> count(3, 0);
  for (const auto& labels : split.labels) {
    for (const KeypointLabel label : labels) ++count[static_cast<size_t>(label)];
  }
  context.out() << "case               " << CaptureCaseName(split.capture_case) << '\n'
                << "stations           " << split.stations.images.size() << '\n'
                << "pairs matched      " << split.num_pairs_matched << '\n'
                << "object pairs       " << split.object_pairs.size() << '\n'
                << "static pairs       " << split.static_pairs.size() << " (between stations)\n"
                << "static keypoints   " << count[1] << '\n'
                << "rotating keypoints " << count[2] << '\n'
                << "unknown keypoints  " << count[0] << '\n'
                << "written to         " << output.string() << '\n';
}

}  // namespace s2gs
