#include "plugin/stage/scan_input.h"

#include <algorithm>
#include <map>
#include <utility>

#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/scene/io/colmap_database.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr uint64_t kMaxLabelsBytes = uint64_t{1} << 31;
constexpr const char* kRemedy = "Run `s2gs motion_splitter` again";

fs::path LabelsPath(const Workspace& workspace) {
  return workspace.ObjectDatabase().parent_path() / "labels.json";
}

std::string ReadLabelsText(const fs::path& path) {
  return ReadWholeFile(path, kMaxLabelsBytes, "Run `s2gs motion_splitter` first");
}

// Pairs of images by their ids, as pairs of the images' places.
class PairCollector {
 public:
  PairCollector(const std::filesystem::path& database, const std::vector<ScanImage>& images)
      : database_(database), images_(images) {
    for (size_t i = 0; i < images.size(); ++i) image_of_id_[images[i].image_id] = static_cast<int>(i);
  }

  void Add(uint32_t id1, uint32_t id2, const FeatureMatches& matches, std::vector<ImagePairMatches>* pairs) {
    const auto first = image_of_id_.find(id1);
    const auto second = image_of_id_.find(id2);
    if (first == image_of_id_.end() || second == image_of_id_.end() || matches.empty()) return;
    const size_t size1 = images_[static_cast<size_t>(first->second)].keypoints.size();
    const size_t size2 = images_[static_cast<size_t>(second->second)].keypoints.size();
    for (const FeatureMatch& match : matches) {
      if (match.point2D_idx1 < size1 && match.point2D_idx2 < size2) continue;
      throw UserError(database_,
                      "matches keypoints of images " + std::to_string(id1) + " and " + std::to_string(id2) +
                          " that do not exist",
                      kRemedy);
    }
    pairs->push_back({first->second, second->second, matches});
    if (first->second < second->second) return;
    std::swap(pairs->back().image1, pairs->back().image2);
    for (FeatureMatch& match : pairs->back().matches) std::swap(match.point2D_idx1, match.point2D_idx2);
  }

  // Pairs in the order of images, which the database keeps by their numbers.
  static void Sort(std::vector<ImagePairMatches>* pairs) {
    std::sort(pairs->begin(), pairs->end(), [](const ImagePairMatches& a, const ImagePairMatches& b) {
      return std::make_pair(a.image1, a.image2) < std::make_pair(b.image1, b.image2);
    });
  }

 private:
  std::filesystem::path database_;
  const std::vector<ScanImage>& images_;
  std::map<uint32_t, int> image_of_id_;
};

std::vector<ImagePairMatches> ReadVerifiedPairs(const ColmapDatabase& database,
                                                const std::vector<ScanImage>& images) {
  std::vector<ImagePairMatches> pairs;
  PairCollector collector(database.path(), images);
  database.ForEachTwoViewGeometry([&](uint32_t id1, uint32_t id2, const TwoViewGeometry& geometry) {
    collector.Add(id1, id2, geometry.inlier_matches, &pairs);
  });
  PairCollector::Sort(&pairs);
  return pairs;
}

std::vector<ImagePairMatches> ReadRawPairs(const ColmapDatabase& database,
                                           const std::vector<ScanImage>& images) {
  std::vector<ImagePairMatches> pairs;
  PairCollector collector(database.path(), images);
  database.ForEachMatches([&](uint32_t id1, uint32_t id2, const FeatureMatches& matches) {
    collector.Add(id1, id2, matches, &pairs);
  });
  PairCollector::Sort(&pairs);
  return pairs;
}

// Raw matches of static keypoints between photos that stand for their stations: others in the database are of
// single photos, and say the same again.
std::vector<ImagePairMatches> ReadRawStaticPairs(const ColmapDatabase& database, const SplitLabels& split,
                                                 const std::vector<ScanImage>& images) {
  std::vector<ImagePairMatches> pairs;
  for (ImagePairMatches& pair : ReadRawPairs(database, images)) {
    const ScanImage& image1 = images[static_cast<size_t>(pair.image1)];
    const ScanImage& image2 = images[static_cast<size_t>(pair.image2)];
    if (image1.station == image2.station || !split.images.at(image1.name).represents_station ||
        !split.images.at(image2.name).represents_station) {
      continue;
    }
    FeatureMatches& matches = pair.matches;
    matches.erase(std::remove_if(matches.begin(), matches.end(),
                                 [&](const FeatureMatch& match) {
                                   return image1.labels[match.point2D_idx1] != KeypointLabel::kStatic ||
                                          image2.labels[match.point2D_idx2] != KeypointLabel::kStatic;
                                 }),
                  matches.end());
    if (!matches.empty()) pairs.push_back(std::move(pair));
  }
  return pairs;
}

std::vector<KeypointLabel> ParseLabels(const std::string& text) {
  std::vector<KeypointLabel> labels;
  labels.reserve(text.size());
  for (const char digit : text) {
    if (digit < '0' || digit > '2') return {};
    labels.push_back(static_cast<KeypointLabel>(digit - '0'));
  }
  return labels;
}

}  // namespace

ScanInput ReadScanInput(const Workspace& workspace) {
  const fs::path path = LabelsPath(workspace);
  const SplitLabels split = ParseSplitLabels(ReadLabelsText(path), path);
  ScanInput input;
  input.capture_case = split.capture_case;
  input.reason = split.reason;

  const ColmapDatabase object =
      ColmapDatabase::Open(workspace.ObjectDatabase(), ColmapDatabase::Access::kReadOnly);
  ScanFeatures& features = input.features;
  for (const DatabaseCamera& camera : object.ReadCameras()) {
    features.cameras[camera.camera.camera_id] = camera.camera;
    features.has_prior_focal[camera.camera.camera_id] = camera.has_prior_focal_length;
  }
  for (const DatabaseImage& row : object.ReadImages()) {
    ScanImage image;
    image.name = row.name;
    image.image_id = row.image_id;
    image.camera_id = row.camera_id;
    const auto found = split.images.find(row.name);
    if (found == split.images.end()) {
      throw UserError(path, "does not know image " + row.name + " of " + workspace.ObjectDatabase().string(),
                      kRemedy);
    }
    image.station = found->second.station;
    image.photo_from_first = found->second.photo_from_first;
    const KeypointMatrix keypoints = object.ReadKeypoints(row.image_id);
    image.keypoints.reserve(static_cast<size_t>(keypoints.rows()));
    for (Eigen::Index k = 0; k < keypoints.rows(); ++k)
      image.keypoints.emplace_back(keypoints(k, 0), keypoints(k, 1));
    image.labels = ParseLabels(found->second.labels);
    if (image.labels.size() != image.keypoints.size()) {
      throw UserError(path,
                      "has labels of image " + row.name + " that do not fit its " +
                          std::to_string(image.keypoints.size()) + " keypoints",
                      kRemedy);
    }
    features.images.push_back(std::move(image));
  }
  std::sort(features.images.begin(), features.images.end(), [&](const ScanImage& a, const ScanImage& b) {
    return split.images.at(a.name).place < split.images.at(b.name).place;
  });
  features.object_pairs = ReadVerifiedPairs(object, features.images);
  features.raw_pairs = ReadRawPairs(object, features.images);
  std::error_code ec;
  if (fs::exists(workspace.StaticDatabase(), ec)) {
    const ColmapDatabase background =
        ColmapDatabase::Open(workspace.StaticDatabase(), ColmapDatabase::Access::kReadOnly);
    features.static_pairs = ReadVerifiedPairs(background, features.images);
    features.raw_static_pairs = ReadRawStaticPairs(background, split, features.images);
  }
  return input;
}

void WriteScanLabels(const Workspace& workspace, const std::vector<ScanImage>& images,
                     const std::vector<std::vector<KeypointLabel>>& labels) {
  const fs::path path = LabelsPath(workspace);
  std::map<std::string, std::string> of_name;
  for (size_t i = 0; i < images.size(); ++i) {
    std::string& text = of_name[images[i].name];
    text.reserve(labels[i].size());
    for (const KeypointLabel label : labels[i])
      text.push_back(static_cast<char>('0' + static_cast<int>(label)));
  }
  const std::string replaced = ReplaceSplitLabels(ReadLabelsText(path), of_name, path);
  WriteFileAtomically(path, [&](std::ostream& stream) { stream << replaced; });
}

}  // namespace s2gs
