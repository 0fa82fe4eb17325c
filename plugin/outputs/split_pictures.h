#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>

#include "plugin/outputs/split_files.h"
#include "sfm_split/base/reporter.h"
#include "sfm_split/split/motion_split.h"

namespace s2gs {

/// Reads the photos of a database's images, reduced and in grey, and finds out which were taken from one
/// place and what changes there. Nothing, with a warning, where a photo is missing, cannot be read or has
/// another size than the database says: then features alone must do.
std::optional<ScanPictures> ReadScanPictures(const std::filesystem::path& image_path,
                                             const SplitFeatures& features, const StationOptions& options,
                                             Reporter& reporter);

/// Where the pictures tell another order of capture than the names do, puts features and pictures in it:
/// everything after takes the order of images for a hint of how the table turned.
void TakeOrderOfCapture(const StationOptions& options, ScanPictures* pictures, SplitFeatures* features,
                        Reporter& reporter);

/// Looks again at lower thresholds where things change, and adds what it finds to `features` where that is
/// enough to lower the poses' standard deviations (kLeastFeatureGain). Returns the number of features added.
/// \param always  even where it is not.
int64_t AddWeakFeatures(const std::filesystem::path& image_path, const ScanPictures& pictures, bool always,
                        SplitFeatures* features, Reporter& reporter);

/// One grey PNG a photo, NAME.png: how much each pixel of the reduced photo differs from what its station
/// shows in most photos, in units of ChangeMap::kLevelsPerSigma. Photos of stations with too few have none.
/// Throws UserError for a name whose map would lie outside the folder, or replace a photo in `image_path`.
void WriteChangeMaps(const std::filesystem::path& folder, const std::filesystem::path& image_path,
                     const SceneChanges& changes, const SplitFeatures& features);

}  // namespace s2gs
