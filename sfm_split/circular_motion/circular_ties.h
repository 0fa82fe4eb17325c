#pragma once

#include <Eigen/Core>
#include <vector>

#include "sfm_split/base/rigid3.h"
#include "sfm_split/circular_motion/epipolar_gain.h"

namespace s2gs {

// Stations whose axis and table angles are known, each in a unit of its own: what is left are three numbers
// for each station against another one, its distance from the axis, its height along it and its turn about
// it. All matches between the two stations' photos tell them together, by the mixture of circular_motion.h.

/// A photo as seen from its station's place at the distance 1 from the axis.
struct CircularView {
  Eigen::Matrix3d cam_from_axis =
      Eigen::Matrix3d::Identity();  ///< axis' frame: z along it, camera at (1, 0).
  double angle_rad = 0;             ///< of the table.
};

/// Where a station's camera stands: at (distance, 0, height) of a frame that is turned by `turn_rad` about
/// the axis.
struct CircularPlace {
  double distance = 1;
  double height = 0;
  double turn_rad = 0;
};

/// cam_from_object of a view of a station.
Rigid3 CamFromObject(const CircularView& view, const CircularPlace& place);

/// Matches of a photo of a placed station with one of the station that is to be placed.
struct CrossingPair {
  Rigid3 cam_from_object;  ///< of the placed one.
  CircularView view;       ///< of the other one.
  double placed_focal_px = 0;
  double focal_px = 0;
  std::vector<RayMatch> matches;  ///< in the placed photo, in the other.
};

struct CircularTie {
  bool found = false;
  CircularPlace place;
  double gain = 0;    ///< logarithm of the likelihood over that of chance alone.
  double margin = 0;  ///< gain less that of the best turn 15 degrees or more away.
};

/// \param start     distance and height to search about.
/// \param sigma_px  of a right match's epipolar error.
CircularTie TieCircularStation(const std::vector<CrossingPair>& pairs, const CircularPlace& start,
                               double sigma_px);

}  // namespace s2gs
