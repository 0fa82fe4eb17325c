#pragma once

#include <string>

#include "sfm_split/relocalise/scan_refinement.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

/// One way of placing the object (free SfM, the single axis), adjusted.
struct ScanCandidate {
  AlignedScene aligned;
  RefineReport refined;
  std::string finding;  ///< what came of it, for the report.
  bool is_usable = false;

  /// Grows as the sum over images of the root of their observations would if all had as many: a few images
  /// more do not outweigh a fit that explains a fraction of the matches, and the matches of a few images do
  /// not outweigh many.
  double Evidence() const {
    return static_cast<double>(aligned.scene.views.size()) *
           static_cast<double>(refined.joint.object_observations);
  }
  bool IsBetterThan(const ScanCandidate& other) const {
    if (is_usable != other.is_usable) return is_usable;
    return Evidence() > other.Evidence();
  }
};

}  // namespace s2gs
