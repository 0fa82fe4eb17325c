#pragma once

#include <vector>

#include "sfm_split/split/motion_split.h"

namespace s2gs {

/// How many other photos of its station show a keypoint unmoved, and of how many that were looked at.
struct StillSupport {
  std::vector<std::vector<int>> support;  ///< per image, per keypoint.
  std::vector<int> num_partners;          ///< per image.
  /// Per image, per keypoint: the photos that show it and its own one all lie within less than half of the
  /// station's, one after the other. What turns does so where its path's picture turns back: at the sides, or
  /// near the axis. The background seldom does, where something covers it in all the others.
  std::vector<std::vector<bool>> lingers;
  /// Per image, per keypoint: the chance of a photo to show one that looks like it within the same distance
  /// of any place, as keypoints do that lie up to four times as far from its own in the other photos. On a
  /// table full of speckles, or where texture is weak and looks the same all over, that is often.
  std::vector<std::vector<float>> chance;
};

/// Looks every keypoint up at its own pixel (moved on by the stations' shake) in the other photos of its
/// station, up to 32 of them spread evenly: unmoved means a keypoint within max_unmoved_px whose descriptor
/// is close. Unlike matching by descriptors alone this takes no time to speak of, and repeated texture does
/// not disturb it.
StillSupport FindStillSupport(const std::vector<SplitImage>& images, const Stations& stations,
                              double max_unmoved_px);

}  // namespace s2gs
