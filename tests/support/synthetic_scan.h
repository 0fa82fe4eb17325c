#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "sfm_split/adjust/track_triangulation.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "sfm_split/scene/scan_features.h"
#include "tests/support/synthetic_turntable.h"

namespace s2gs {

/// What a split would know of a synthetic turntable: true labels, all rotating matches, the static ones
/// between the stations' first images; outliers go where their first keypoint belongs.
ScanFeatures SyntheticScanFeatures(const SyntheticTurntable& turntable);

/// By name.
std::map<std::string, int> StationsOf(const ScanFeatures& features);

/// Where the object's images truly stand, for triangulation; the poses refer to the turntable's cameras.
std::vector<PosedImage> TruePosesOfObject(const SyntheticTurntable& turntable);

/// Of all images [px].
std::vector<Keypoints> KeypointsOf(const ScanFeatures& features);

/// What SfM gets wrong.
struct ModelFaults {
  double rotation_deg = 0;   ///< standard deviation of each pose's rotation, per axis.
  double centre_rel = 0;     ///< of each centre, per coordinate, over its distance from the points' mean.
  double point_rel = 0;      ///< of each point, over the same distance.
  double missing_share = 0;  ///< of the images.
  double wrong_share = 0;    ///< images with poses that have nothing to do with the truth.
  double focal_factor = 1;   ///< of all cameras.
};

void DamageModel(const ModelFaults& faults, uint32_t seed, ColmapModel* model);

}  // namespace s2gs
