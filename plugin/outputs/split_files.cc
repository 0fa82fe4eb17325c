#include "plugin/outputs/split_files.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <ostream>
#include <system_error>
#include <utility>

#include "s2gs/image/image_file.h"
#include "s2gs/image/photo_folder.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/matching/pair_plan.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

float ScaleOf(const KeypointMatrix& keypoints, Eigen::Index row) {
  if (keypoints.cols() == 4) return keypoints(row, 2);
  if (keypoints.cols() == 6) {
    return std::sqrt(std::abs(keypoints(row, 2) * keypoints(row, 5) - keypoints(row, 3) * keypoints(row, 4)));
  }
  return 1.0F;
}

// Rows of COLMAP's two, four or six columns: place; scale and orientation; or an affine shape.
KeypointMatrix WithAdded(const KeypointMatrix& keypoints, const SiftFeatures& added) {
  KeypointMatrix all(keypoints.rows() + static_cast<Eigen::Index>(added.keypoints.size()), keypoints.cols());
  all.topRows(keypoints.rows()) = keypoints;
  for (size_t k = 0; k < added.keypoints.size(); ++k) {
    auto row = all.row(keypoints.rows() + static_cast<Eigen::Index>(k));
    row.head<2>() = added.keypoints[k].transpose();
    const float scale = added.scales[k];
    const float angle = added.orientations[k];
    if (all.cols() == 4) row.tail<2>() << scale, angle;
    if (all.cols() == 6) {
      row.tail<4>() << scale * std::cos(angle), -scale * std::sin(angle), scale * std::sin(angle),
          scale * std::cos(angle);
    }
  }
  return all;
}

void WriteAdded(const SplitFeatures& features, ColmapDatabase* database) {
  for (size_t i = 0; i < features.added.size(); ++i) {
    const SiftFeatures& added = features.added[i];
    if (added.keypoints.empty()) continue;
    const uint32_t image_id = features.rows[i].image_id;
    database->WriteKeypoints(image_id, WithAdded(database->ReadKeypoints(image_id), added));
    const SplitImage& image = features.images[i];
    const Eigen::Map<const DescriptorMatrix> descriptors(
        image.descriptors.data(), static_cast<Eigen::Index>(image.keypoints.size()), kDescriptorSize);
    database->WriteDescriptors(image_id, descriptors);
  }
}

}  // namespace

SplitFeatures ReadSplitFeatures(const fs::path& database_path) {
  const ColmapDatabase database = ColmapDatabase::Open(database_path, ColmapDatabase::Access::kReadOnly);
  std::map<uint32_t, Camera> cameras;
  for (const DatabaseCamera& camera : database.ReadCameras())
    cameras[camera.camera.camera_id] = camera.camera;
  const std::vector<DatabaseImage> rows = database.ReadImages();
  std::vector<std::string> names;
  names.reserve(rows.size());
  for (const DatabaseImage& row : rows) names.push_back(row.name);

  SplitFeatures features;
  features.rows.reserve(rows.size());
  features.images.reserve(rows.size());
  for (const uint32_t i : NaturalNameOrder(names)) {
    const DatabaseImage& row = rows[i];
    SplitImage image;
    image.name = row.name;
    const auto camera = cameras.find(row.camera_id);
    if (camera == cameras.end()) {
      throw UserError(database_path, "image " + row.name + " refers to a camera that is not there",
                      "Run `colmap feature_extractor` again on a new database");
    }
    image.size =
        Eigen::Vector2i(static_cast<int>(camera->second.width), static_cast<int>(camera->second.height));
    const KeypointMatrix keypoints = database.ReadKeypoints(row.image_id);
    image.keypoints.reserve(keypoints.rows());
    image.scales.reserve(keypoints.rows());
    for (Eigen::Index k = 0; k < keypoints.rows(); ++k) {
      image.keypoints.emplace_back(keypoints(k, 0), keypoints(k, 1));
      const float scale = ScaleOf(keypoints, k);
      image.scales.push_back(std::isfinite(scale) ? scale : 0.0F);
    }
    const DescriptorMatrix descriptors = database.ReadDescriptors(row.image_id);
    if (descriptors.rows() != keypoints.rows()) {
      throw UserError(database_path,
                      "image " + row.name + " has " + std::to_string(keypoints.rows()) + " keypoints but " +
                          std::to_string(descriptors.rows()) + " descriptors",
                      "Run `colmap feature_extractor` again on a new database");
    }
    image.descriptors.assign(descriptors.data(), descriptors.data() + descriptors.size());
    features.rows.push_back(row);
    features.images.push_back(std::move(image));
  }
  if (features.images.size() < 3) {
    throw UserError(database_path,
                    "has " + std::to_string(features.images.size()) + " images; a split needs at least three",
                    features.images.empty()
                        ? "Run `colmap feature_extractor` on all photos first"
                        : "Take more photos: a whole turn of the table in steps of 20 degrees has 18");
  }
  return features;
}

GivenMatches ReadGivenMatches(const fs::path& database_path, const SplitFeatures& features) {
  const ColmapDatabase database = ColmapDatabase::Open(database_path, ColmapDatabase::Access::kReadOnly);
  std::map<uint32_t, uint32_t> image_of_id;
  for (uint32_t i = 0; i < features.rows.size(); ++i) image_of_id[features.rows[i].image_id] = i;
  GivenMatches given;
  database.ForEachMatches([&](uint32_t image_id1, uint32_t image_id2, const FeatureMatches& matches) {
    const auto found1 = image_of_id.find(image_id1);
    const auto found2 = image_of_id.find(image_id2);
    if (found1 == image_of_id.end() || found2 == image_of_id.end()) return;
    const uint32_t image1 = found1->second;
    const uint32_t image2 = found2->second;
    FeatureMatches& ordered = given[{std::min(image1, image2), std::max(image1, image2)}];
    ordered = matches;
    if (image1 > image2) {
      for (FeatureMatch& match : ordered) std::swap(match.point2D_idx1, match.point2D_idx2);
    }
  });
  if (given.empty()) {
    throw UserError(database_path, "has no matches, but --use_matches asks for them",
                    "Run `colmap exhaustive_matcher` on it first, or leave out --use_matches");
  }
  return given;
}

void ApplyMasks(const fs::path& mask_path, SplitFeatures* features, Reporter& reporter) {
  size_t num_without = 0;
  for (SplitImage& image : features->images) {
    const fs::path path = FindMask(mask_path, image.name);
    if (path.empty()) {
      ++num_without;
      image.given_labels.assign(image.keypoints.size(), KeypointLabel::kUnknown);
      continue;
    }
    const Image8 mask = ReadMask(path);
    if (mask.width != image.size.x() || mask.height != image.size.y()) {
      throw UserError(path,
                      "is " + std::to_string(mask.width) + " x " + std::to_string(mask.height) +
                          " pixels, its photo " + std::to_string(image.size.x()) + " x " +
                          std::to_string(image.size.y()),
                      "Make masks of the photos' size");
    }
    image.given_labels.reserve(image.keypoints.size());
    for (const Eigen::Vector2f& xy : image.keypoints) {
      const int x = std::clamp(static_cast<int>(xy.x()), 0, mask.width - 1);
      const int y = std::clamp(static_cast<int>(xy.y()), 0, mask.height - 1);
      image.given_labels.push_back(*mask.Pixel(x, y) > 0 ? KeypointLabel::kRotating : KeypointLabel::kStatic);
    }
  }
  if (num_without == features->images.size()) {
    throw UserError(mask_path, "has no mask for any of the photos", kMaskNames);
  }
  if (num_without > 0) {
    reporter.Warn(std::to_string(num_without) + " photos have no mask in " + mask_path.string() +
                  " and are left out");
  }
}

void AppendStationFeatures(MotionSplit* split, SplitFeatures* features) {
  if (split->station_features.empty()) return;
  features->added.resize(features->images.size());
  for (const StationFeatures& merged : split->station_features) {
    SplitImage& image = features->images[merged.image];
    SiftFeatures& added = features->added[merged.image];
    for (Keypoints* keypoints : {&image.keypoints, &added.keypoints})
      keypoints->insert(keypoints->end(), merged.keypoints.begin(), merged.keypoints.end());
    for (std::vector<float>* scales : {&image.scales, &added.scales})
      scales->insert(scales->end(), merged.scales.begin(), merged.scales.end());
    for (std::vector<uint8_t>* descriptors : {&image.descriptors, &added.descriptors})
      descriptors->insert(descriptors->end(), merged.descriptors.begin(), merged.descriptors.end());
    added.orientations.resize(added.keypoints.size(), 0.0F);  // the descriptors are means over the photos
    split->labels[merged.image].resize(image.keypoints.size(), KeypointLabel::kStatic);
    S2GS_INVARIANT(split->labels[merged.image].size() == image.descriptors.size() / kDescriptorSize);
  }
  split->station_features.clear();
}

void WriteSplitDatabase(const fs::path& database_path, const fs::path& path, const SplitFeatures& features,
                        const std::vector<VerifiedPair>& pairs, const std::vector<ImagePairMatches>& matches,
                        Reporter& reporter) {
  std::vector<TwoViewGeometryOfPair> geometries;
  geometries.reserve(pairs.size());
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
  ColmapDatabase::SafeCopy(database_path, path, reporter, [&](ColmapDatabase& copy) {
    copy.ReplaceTwoViewGeometries(geometries);
    copy.InTransaction([&] { WriteAdded(features, &copy); });
    copy.InTransaction([&] {
      for (const ImagePairMatches& pair : matches) {
        copy.WriteMatches(features.rows[pair.image1].image_id, features.rows[pair.image2].image_id,
                          pair.matches);
      }
    });
  });
}

void WriteLabels(const fs::path& path, const MotionSplit& split, const SplitFeatures& features) {
  nlohmann::json images = nlohmann::json::array();
  for (size_t i = 0; i < features.images.size(); ++i) {
    std::string labels;
    labels.reserve(split.labels[i].size());
    for (const KeypointLabel label : split.labels[i])
      labels.push_back(static_cast<char>('0' + static_cast<int>(label)));
    nlohmann::json image = {{"name", features.images[i].name},
                            {"image_id", features.rows[i].image_id},
                            {"station", split.stations.station_of_image[i]},
                            {"represents_station",
                             split.representative[split.stations.station_of_image[i]] == static_cast<int>(i)},
                            {"labels", labels}};
    const Eigen::Matrix3d shake = split.stations.PhotoFromFirst(static_cast<int>(i));
    if (shake != Eigen::Matrix3d::Identity()) {
      const Eigen::Matrix<double, 3, 3, Eigen::RowMajor> rows = shake;
      image["photo_from_first"] = std::vector<double>(rows.data(), rows.data() + rows.size());
    }
    images.push_back(std::move(image));
  }
  int64_t num_added = 0;
  for (const SiftFeatures& added : features.added) num_added += static_cast<int64_t>(added.keypoints.size());
  const nlohmann::json file = {{"version", 1},
                               {"case", CaptureCaseName(split.capture_case)},
                               {"reason", split.reason},
                               {"warnings", split.warnings},
                               {"label_values", {{"0", "unknown"}, {"1", "static"}, {"2", "rotating"}}},
                               {"pairs_matched", split.num_pairs_matched},
                               {"features_added", num_added},
                               {"changing_features", features.changing},
                               {"weak_features", features.found},
                               {"takes_weak_features", features.takes_found},
                               {"object_pairs", split.object_pairs.size()},
                               {"ringed_photos", split.ringed_photos},
                               {"station_photos", split.station_photos},
                               {"num_stations", split.stations.images.size()},
                               {"images", images}};
  WriteFileAtomically(path, [&](std::ostream& stream) {
    // File names may hold bytes that are no UTF-8.
    stream << file.dump(1, ' ', false, nlohmann::json::error_handler_t::replace) << '\n';
  });
}

}  // namespace s2gs
