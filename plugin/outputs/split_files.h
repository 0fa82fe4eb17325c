#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "sfm_split/base/reporter.h"
#include "sfm_split/matching/weak_features.h"
#include "sfm_split/scene/io/colmap_database.h"
#include "sfm_split/split/motion_split.h"

namespace s2gs {

/// A database's features, as the split takes them.
struct SplitFeatures {
  std::vector<DatabaseImage> rows;  ///< as images.
  std::vector<SplitImage> images;   ///< in the natural order of names, or in that of capture.
  /// Per image, or none at all: features that the database lacks; they stand last among the image's.
  std::vector<SiftFeatures> added;
  /// Features of a photo where things change, and what a search at lower thresholds finds there beside them,
  /// the medians over photos; 0: nobody asked (AddWeakFeatures).
  int changing = 0;
  int found = 0;
  bool takes_found = false;  ///< they are among `added`.
};

/// Throws UserError when the database is damaged or has fewer than three images.
SplitFeatures ReadSplitFeatures(const std::filesystem::path& database_path);

/// The raw matches that a database has of these images' pairs, of `colmap exhaustive_matcher`, say.
/// Throws UserError when it has none or names keypoints that are not there.
GivenMatches ReadGivenMatches(const std::filesystem::path& database_path, const SplitFeatures& features);

/// Labels keypoints inside a mask as rotating and the others as static. Masks lie as COLMAP wants them: that
/// of sub/a.jpg is sub/a.jpg.png (or sub/a.png), not zero where the part rotates. Images without a mask keep
/// none of their keypoints from either body and are warned about.
/// Throws UserError when no image has a mask, or one has another size than its image.
void ApplyMasks(const std::filesystem::path& mask_path, SplitFeatures* features, Reporter& reporter);

/// Appends the backgrounds of whole stations to the features and labels of the images that carry them.
void AppendStationFeatures(MotionSplit* split, SplitFeatures* features);

/// Copies `database_path` to `path` with these pairs as its two-view geometries, and with the features that
/// were added.
/// \param matches  what goes into its table of raw matches.
void WriteSplitDatabase(const std::filesystem::path& database_path, const std::filesystem::path& path,
                        const SplitFeatures& features, const std::vector<VerifiedPair>& pairs,
                        const std::vector<ImagePairMatches>& matches, Reporter& reporter);

/// labels.json: the case and its reason, pairs that were matched, features that were added, per image its
/// station and per keypoint its label.
void WriteLabels(const std::filesystem::path& path, const MotionSplit& split, const SplitFeatures& features);

}  // namespace s2gs
