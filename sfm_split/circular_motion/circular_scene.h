#pragma once

#include "sfm_split/base/reporter.h"
#include "sfm_split/circular_motion/circular_motion.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

/// Another motion that matches do not tell from the one that was found, and its scene.
struct CircularRival {
  CircularMotion motion;
  int placed_stations = 0;
  AlignedScene aligned;
};

/// What came of FitCircularMotion on a scan.
struct CircularFinding {
  CircularMotion motion;
  std::vector<int> stations;  ///< the features' numbers, one per station of `motion`.
  int placed_stations = 0;    ///< of which the object's matches tell how they stand to each other.
  std::vector<CircularRival> rivals;
};

/// An aligned scene, without points, of the photos whose table angles circular motion tells: each station's
/// camera against the axis from the matches inside it, and how stations stand to each other (distance, height
/// and turn about the axis) from the object's matches between them. The angle about the axis between two
/// stations' cameras is unknown without the background: it is 0 at the first photo of each, by definition, as
/// in AlignScene without a background. Raw matches are used where there are any, else verified ones. Empty
/// when no station's circular motion was found. Throws Interrupted when the reporter asks to stop.
AlignedScene SceneFromCircularMotion(const ScanFeatures& features, const CircularOptions& options,
                                     Reporter& reporter, CircularFinding* finding);

/// The stations of a scan and their matches that may be the object's, photos in the order of the features.
/// \param cameras  of the scan, in the order that stations refer to.
std::vector<CircularStation> CollectCircularStations(const ScanFeatures& features,
                                                     const std::vector<uint32_t>& cameras,
                                                     std::vector<int>* numbers);

}  // namespace s2gs
