#pragma once

#include <Eigen/Core>
#include <vector>

#include "sfm_split/base/reporter.h"
#include "sfm_split/base/rigid3.h"
#include "sfm_split/circular_motion/epipolar_gain.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

// The table as several cameras see it whose places the background tells: one axis in the world, four numbers,
// for all of them, and of each station which way its photos follow the turn and at which angle it begins.
// Steps are those that close a turn after a station's photos. All matches count, inside stations and between
// them, by the mixture of circular_motion.h: photos of two stations at one angle of the table often share
// more than two photos of one station a step apart, and none of these pairs need be verified by itself.

struct RiggedStation {
  Rigid3 cam_from_world;
  double focal_px = 0;
  int num_photos = 0;
};

/// Matches of two photos that may be the object's; most may be wrong.
struct RiggedPair {
  int station1 = 0;
  int photo1 = 0;  ///< place in the station's order of capture.
  int station2 = 0;
  int photo2 = 0;
  std::vector<RayMatch> matches;
};

struct RiggedCircle {
  TurntableAxis axis;                          ///< in the world of the stations' cameras.
  std::vector<std::vector<double>> angle_rad;  ///< per station and photo; 0 at the first photo of all.
  double gain = 0;                             ///< logarithm of the likelihood over that of chance alone.
};

/// Circles that the matches bear out, the likeliest first; none where chance does as well, or of less than
/// two stations in different places. The noise with which they are told apart is that of stations that do not
/// stand where they are likeliest yet. \param extent_px  of the object: a wrong match lies anywhere along it.
/// \param sigma_px   of a right match's epipolar error.
/// Throws Interrupted when the reporter asks to stop.
std::vector<RiggedCircle> FitRiggedCircles(const std::vector<RiggedStation>& stations,
                                           const std::vector<RiggedPair>& pairs, double extent_px,
                                           double sigma_px, Reporter& reporter);

}  // namespace s2gs
