#include "plugin/mapping/mapping_failure.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstddef>
#include <string>
#include <vector>

#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

// COLMAP's mapper begins with two photos of 100 common points, in its most tolerant settings here of 20.
constexpr size_t kFewestFeatures = 100;
constexpr size_t kFewestMatches = 20;
// Keypoints are found to about half a pixel: a match that moves by less than three of that did not move.
constexpr float kUnmovedPx = 1.5F;
constexpr double kUnmovedShare = 0.9;

struct MatchCounts {
  size_t matches = 0;
  size_t unmoved = 0;
  size_t usable_pairs = 0;
};

MatchCounts CountMatches(const ScanFeatures& features) {
  MatchCounts counts;
  for (const ImagePairMatches& pair : AllPairs(features)) {
    const Keypoints& first = features.images[static_cast<size_t>(pair.image1)].keypoints;
    const Keypoints& second = features.images[static_cast<size_t>(pair.image2)].keypoints;
    for (const FeatureMatch& match : pair.matches) {
      const float moved = (first[match.point2D_idx1] - second[match.point2D_idx2]).norm();
      counts.unmoved += moved <= kUnmovedPx ? 1 : 0;
    }
    counts.matches += pair.matches.size();
    counts.usable_pairs += pair.matches.size() >= kFewestMatches ? 1 : 0;
  }
  return counts;
}

// Photos that were taken from one camera position.
int LargestStation(const ScanFeatures& features) {
  int largest = 0;
  for (const auto& [station, size] : SizesOfStations(features)) largest = std::max(largest, size);
  return largest;
}

constexpr const char* kStandsStill =
    "Photograph the object at different angles of the table; an object without texture needs a speckled "
    "sheet "
    "under it";

}  // namespace

UserError ExplainNoModel(const std::filesystem::path& path, const ScanFeatures& features) {
  std::vector<size_t> num_features;
  num_features.reserve(features.images.size());
  for (const ScanImage& image : features.images) num_features.push_back(image.keypoints.size());
  const std::string finding = "colmap mapper found no model of the photos: ";
  const size_t median = UpperMedian(num_features);
  if (!num_features.empty() && median < kFewestFeatures) {
    return {path, finding + fmt::format("they show too little texture, {} features a photo (median)", median),
            "Sharper, brighter or larger photos help, and a speckled sheet or printed markers on the table"};
  }
  const MatchCounts counts = CountMatches(features);
  const int largest = LargestStation(features);
  if (counts.usable_pairs == 0 && largest > 1 && 2 * static_cast<size_t>(largest) > features.images.size()) {
    // What stood still was taken out by the split: nothing is left.
    return {
        path,
        finding + fmt::format("{} of {} show the same from one camera position, and nothing in them turns",
                              largest, features.images.size()),
        kStandsStill};
  }
  if (counts.usable_pairs == 0) {
    return {path, finding + fmt::format("no two of them show {} points in common", kFewestMatches),
            "Check that they are photos of one object; smaller steps of the table (20 degrees or less) help, "
            "and light "
            "that stays as it is"};
  }
  if (static_cast<double>(counts.unmoved) >= kUnmovedShare * static_cast<double>(counts.matches)) {
    return {path,
            finding + fmt::format(
                          "{:.0f} % of what they have in common stands still in the picture, so neither the "
                          "table turned nor the camera moved",
                          100.0 * static_cast<double>(counts.unmoved) / static_cast<double>(counts.matches)),
            kStandsStill};
  }
  return {
      path,
      finding + fmt::format("{} pairs have matches, but no two views of one rigid body", counts.usable_pairs),
      "Look at colmap's output with --log_level debug; smaller steps of the table, more texture, or an "
      "object and "
      "table that turn as one help"};
}

}  // namespace s2gs
