#pragma once

#include <filesystem>

#include "tests/support/synthetic_turntable.h"

namespace s2gs {

/// Which verified matches a synthetic database gets.
enum class SyntheticGeometries {
  kNone,      ///< raw matches only, as before geometric verification.
  kRotating,  ///< the object's and the platter's true matches with the object's exact E (and F): object.db.
  kStatic,    ///< the background's: static.db.
};

/// Writes a COLMAP database with the turntable's cameras, images (image i has image_id i + 1), keypoints
/// (x, y, scale 1, orientation 0), descriptors if there are any, and all matches, outliers included; replaces
/// the file. Pairs with fewer than 15 true matches get no verified ones. Pairs without a baseline (the static
/// ones of one station) are PANORAMIC with a homography, others CALIBRATED.
void WriteSyntheticDatabase(const std::filesystem::path& path, const SyntheticTurntable& turntable,
                            SyntheticGeometries geometries);

}  // namespace s2gs
