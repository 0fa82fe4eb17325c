#pragma once

#include <vector>

#include "sfm_split/split/motion_split.h"

namespace s2gs {

/// How many other photos of its station show a keypoint unmoved, and of how many that were looked at.
struct StillSupport {
  std::vector<std::vector<int>> support;  ///< per image, per keypoint.
  std::vector<int> num_partners;          ///< per image.
};

/// Looks every keypoint up at its own pixel (moved on by the stations' shake) in the other photos of its
/// station, up to 32 of them spread evenly: unmoved means a keypoint within max_unmoved_px whose descriptor
/// is close. Unlike matching by descriptors alone this takes no time to speak of, and repeated texture does
/// not disturb it.
StillSupport FindStillSupport(const std::vector<SplitImage>& images, const Stations& stations,
                              double max_unmoved_px);

}  // namespace s2gs
