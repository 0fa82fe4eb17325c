#include "plugin/motion_splitter_command.h"

#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <ostream>
#include <string>
#include <vector>

#include "sfm_split/colmap_database.h"
#include "sfm_split/error.h"
#include "sfm_split/file_io.h"
#include "sfm_split/motion_split.h"
#include "sfm_split/pair_plan.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

struct Settings {
  fs::path database_path;
  fs::path output_path;
  StationOptions station;
  DescriptorMatchOptions match;
  TwoViewMotionOptions motion;
  MotionSplitOptions split;
};

void AddOptions(Options& options, Settings* settings) {
  options
      .Add("database_path", &settings->database_path,
           "COLMAP's database with the features of all photos; it is only read")
      .Required();
  options.Add("output_path", &settings->output_path,
              "folder for object.db, static.db and labels.json; empty: split, beside the database");
  auto station = options.Group("Station", &settings->station);
  station.Add("max_unmoved_px", &StationOptions::max_unmoved_px, "a match that moves by no more is unmoved")
      .Unit("px");
  station.Add("max_shake_px", &StationOptions::max_shake_px, "largest shake of the tripod between two photos")
      .Unit("px");
  station.Add("min_unmoved_matches", &StationOptions::min_unmoved_matches,
              "fewest unmoved matches of two photos from one station");
  station.Add("min_unmoved_share", &StationOptions::min_unmoved_share, "their smallest share of the matches");
  station.Add("min_cells", &StationOptions::min_cells,
              "cells of an 8 x 8 grid over the photo that they must fill");
  auto match = options.Group("SiftMatching", &settings->match);
  match.Add("max_ratio", &DescriptorMatchOptions::max_ratio, "best over second best distance of a match");
  match.Add("max_distance", &DescriptorMatchOptions::max_distance, "largest distance of a match")
      .Unit("radians");
  match.Add("cross_check", &DescriptorMatchOptions::cross_check, "matches must be mutual");
  auto motion = options.Group("TwoViewMotion", &settings->motion);
  motion.Add("max_error_px", &TwoViewMotionOptions::max_error_px, "largest epipolar error of an inlier")
      .Unit("px");
  motion.Add("confidence", &TwoViewMotionOptions::confidence, "of the robust fit");
  motion.Add("max_iterations", &TwoViewMotionOptions::max_iterations, "of the robust fit");
  motion.Add("min_inliers", &TwoViewMotionOptions::min_inliers, "fewest matches that make a motion");
  auto split = options.Group("Split", &settings->split);
  split.Add("min_static_support", &MotionSplitOptions::min_static_support,
            "photos of its station that must show a keypoint unmoved before it is background");
  split.Add("min_moved_px", &MotionSplitOptions::min_moved_px, "smallest move that shows the table turning")
      .Unit("px");
  split.Add("max_object_steps", &MotionSplitOptions::max_object_steps,
            "largest distance of the pairs within a station, in steps of the table");
  split.Add("station_window", &MotionSplitOptions::station_window,
            "photos on each side of the best partner in another station that are matched too");
  split.Add("station_probes", &MotionSplitOptions::station_probes,
            "photos of a station that look for their partner among all of another");
}

struct Features {
  std::vector<DatabaseImage> rows;  // as images
  std::vector<SplitImage> images;   // in the natural order of names
};

Features ReadFeatures(const fs::path& path) {
  const ColmapDatabase database = ColmapDatabase::Open(path, ColmapDatabase::Access::kReadOnly);
  std::map<uint32_t, Camera> cameras;
  for (const DatabaseCamera& camera : database.ReadCameras())
    cameras[camera.camera.camera_id] = camera.camera;
  const std::vector<DatabaseImage> rows = database.ReadImages();
  std::vector<std::string> names;
  names.reserve(rows.size());
  for (const DatabaseImage& row : rows) names.push_back(row.name);

  Features features;
  for (const uint32_t i : NaturalNameOrder(names)) {
    const DatabaseImage& row = rows[i];
    SplitImage image;
    image.name = row.name;
    const Camera& camera = cameras.at(row.camera_id);
    image.size = Eigen::Vector2i(static_cast<int>(camera.width), static_cast<int>(camera.height));
    const KeypointMatrix keypoints = database.ReadKeypoints(row.image_id);
    for (Eigen::Index k = 0; k < keypoints.rows(); ++k) {
      image.keypoints.emplace_back(keypoints(k, 0), keypoints(k, 1));
    }
    const DescriptorMatrix descriptors = database.ReadDescriptors(row.image_id);
    if (descriptors.rows() != keypoints.rows()) {
      throw UserError(path,
                      "image " + row.name + " has " + std::to_string(keypoints.rows()) + " keypoints but " +
                          std::to_string(descriptors.rows()) + " descriptors",
                      "Run `colmap feature_extractor` again on a new database");
    }
    image.descriptors.assign(descriptors.data(), descriptors.data() + descriptors.size());
    features.rows.push_back(row);
    features.images.push_back(std::move(image));
  }
  if (features.images.size() < 3) {
    throw UserError(path,
                    "has " + std::to_string(features.images.size()) + " images; a split needs at least three",
                    "Run `colmap feature_extractor` on all photos first");
  }
  return features;
}

void CheckSplit(const fs::path& path, const MotionSplit& split, size_t num_images) {
  if (split.stations.images.size() == num_images) {
    throw UserError(
        path, "no two photos were taken from one camera position",
        "The split needs stations: keep the camera still while the table turns. Photos taken by hand, "
        "and scenes without a textured background, go straight to `colmap mapper`");
  }
  if (split.object_pairs.empty()) {
    throw UserError(
        path, "nothing moves between photos of one station",
        "If the table did turn, the object has too little texture to be seen: put a speckled sheet on "
        "the table, or raise --SiftExtraction.max_num_features in `colmap feature_extractor`");
  }
}

std::vector<TwoViewGeometryOfPair> ToGeometries(const std::vector<VerifiedPair>& pairs,
                                                const Features& features) {
  std::vector<TwoViewGeometryOfPair> geometries;
  for (const VerifiedPair& pair : pairs) {
    TwoViewGeometryOfPair result;
    result.image_id1 = features.rows[pair.image1].image_id;
    result.image_id2 = features.rows[pair.image2].image_id;
    result.geometry.config = TwoViewConfig::kUncalibrated;
    result.geometry.F = pair.F;
    if (pair.is_planar) result.geometry.H = pair.H;
    result.geometry.inlier_matches = pair.matches;
    geometries.push_back(std::move(result));
  }
  return geometries;
}

void WriteLabels(const fs::path& path, const MotionSplit& split, const Features& features) {
  nlohmann::json images = nlohmann::json::array();
  for (size_t i = 0; i < features.images.size(); ++i) {
    std::string labels;
    for (const KeypointLabel label : split.labels[i])
      labels.push_back(static_cast<char>('0' + static_cast<int>(label)));
    images.push_back({{"name", features.images[i].name},
                      {"image_id", features.rows[i].image_id},
                      {"station", split.stations.station_of_image[i]},
                      {"represents_station",
                       split.representative[split.stations.station_of_image[i]] == static_cast<int>(i)},
                      {"labels", labels}});
  }
  const nlohmann::json file = {{"version", 1},
                               {"label_values", {{"0", "unknown"}, {"1", "static"}, {"2", "rotating"}}},
                               {"num_stations", split.stations.images.size()},
                               {"images", images}};
  WriteFileAtomically(path, [&](std::ostream& stream) { stream << file.dump(1) << '\n'; });
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

  const Features features = ReadFeatures(settings.database_path);
  reporter.Info(std::to_string(features.images.size()) + " images read from " +
                settings.database_path.string());
  const MotionSplit split = SplitMotion(features.images, settings.station, settings.match, settings.motion,
                                        settings.split, &reporter);
  CheckSplit(settings.database_path, split, features.images.size());

  CreateFolder(output);
  RemoveStaleTemporaries(output);
  const auto write_database = [&](const char* name, const std::vector<VerifiedPair>& pairs) {
    ColmapDatabase::SafeCopy(settings.database_path, output / name, reporter, [&](ColmapDatabase& copy) {
      copy.ReplaceTwoViewGeometries(ToGeometries(pairs, features));
    });
  };
  write_database("object.db", split.object_pairs);
  write_database("static.db", split.static_pairs);
  WriteLabels(output / "labels.json", split, features);

  std::vector<size_t> count(3, 0);
  for (const auto& labels : split.labels) {
    for (const KeypointLabel label : labels) ++count[static_cast<size_t>(label)];
  }
  context.out() << "stations           " << split.stations.images.size() << '\n'
                << "pairs matched      " << split.num_pairs_matched << '\n'
                << "object pairs       " << split.object_pairs.size() << '\n'
                << "static pairs       " << split.static_pairs.size() << " (between stations)\n"
                << "static keypoints   " << count[1] << '\n'
                << "rotating keypoints " << count[2] << '\n'
                << "unknown keypoints  " << count[0] << '\n'
                << "written to         " << output.string() << '\n';
  if (split.static_pairs.empty()) {
    reporter.Warn("the background is not seen from two stations: there is nothing in static.db to map");
  }
}

}  // namespace s2gs
