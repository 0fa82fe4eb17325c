#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "sfm_split/base/error.h"
#include "sfm_split/base/rigid3.h"

namespace s2gs {

// From two separate reconstructions to one turntable.
//
// SfM of the rotating part gives R_o(t), c_o(t) (camera rotation and centre in the object's frame, object
// units) and SfM of the background R_b(t), C_b(t) (in the background's frame, background units). With the
// object held still in its own frame, it sits in the background's frame at image t by
//     x_b = lambda A_t x_o + s_t,   A_t = R_b(t)^T R_o(t).                                             (1)
// The table turns about one line of the background, through `a` along the unit vector n; that line is also
// fixed in the object, through p / lambda along m. Hence
//     A_t = R(n, theta_t) A_0,   so  A_t m = n for every t,                                            (2)
//     s_t = a - A_t p,           so  C_b(t) = lambda A_t c_o(t) - A_t p + a.                           (3)
// (2) is solved for n and m: minimising sum w |A_t m - n|^2 over unit vectors maximises n^T (sum w A_t) m,
// so n and m are the leading singular vectors of M = sum w A_t. Because M = T (n n^T + c (I - n n^T) +
// s [n]x) A_0 with c + i s the mean of exp(i theta_t), its singular values are T (1, q, q), q = |c + i s|:
// they part as soon as the angles differ. (3) is linear in lambda, p and a. Sliding along the axis,
// p + u m and a + u n, changes nothing; it is fixed by p . m = 0. When all C_b(t) coincide, (lambda, p, C -
// a) can be multiplied by any number: the scale is not observable. Otherwise, since the object's size in the
// background's units is only seen through what moved between stations, sigma_lambda / lambda is about
// sigma_C / |C_1 - C_2|.

/// One image that both reconstructions know.
struct TurntablePose {
  std::string name;
  int station = 0;         ///< images of one station share cam_from_world up to shake.
  Rigid3 cam_from_object;  ///< in the units of the object's reconstruction.
  Rigid3 cam_from_world;   ///< in the units of the background's.
};

struct TurntableOptions {
  int max_seeds = 600;              ///< random minimal samples; every pair when there are fewer.
  double max_seed_error_deg = 2;    ///< axis error from which an image counts as wrong while seeds compete.
  double max_seed_error_rel = 0.1;  ///< the same for offsets, in units of the camera's path about the object.
  double inlier_sigmas = 4.5;       ///< images beyond are outliers ...
  double min_outlier_deg = 0.3;     ///< ... if their axis error exceeds this as well,
  double min_outlier_rel = 0.005;   ///< or their offset this (relative as above).
  double max_axis_sigma_deg = 3;    ///< an axis known less well counts as unobservable: steps too small.
  double max_scale_sigma_rel = 0.1;   ///< a scale known less well counts as unobservable.
  std::optional<double> known_scale;  ///< lambda when it is known, e.g. 1 for poses in one frame's units.
  uint32_t random_seed = 0;

  OptionCheck Check() const;
};

enum class TurntableMotion {
  kRotates,
  kNothingRotates,  ///< object and background keep their relative pose: a static scene.
  kStepsTooSmall,   ///< something turns, but too little to tell about which axis.
  kTooFewImages,    ///< fewer than two images with consistent poses.
};
const char* TurntableMotionName(TurntableMotion motion);

/// How the object lay on the table for some of the images. More than one group: it was turned over, or moved,
/// between rounds.
struct TurntableGroup {
  Eigen::Vector3d axis_in_world = Eigen::Vector3d::UnitZ();   ///< n, unit.
  Eigen::Vector3d axis_in_object = Eigen::Vector3d::UnitZ();  ///< m, unit.
  Eigen::Vector3d point_in_world = Eigen::Vector3d::Zero();   ///< a, background units.
  Eigen::Vector3d point_in_object = Eigen::Vector3d::Zero();  ///< p / lambda, object units; p . m = 0.
  int num_images = 0;
};

struct TurntableImageFit {
  double angle_rad = 0;              ///< about +axis_in_world, 0 at the reference image, in (-pi, pi].
  double rotation_residual_deg = 0;  ///< angle between A_t m and n.
  double offset_residual_rel = 0;    ///< residual of (3) over the camera's path about the object.
  int group = -1;                    ///< index into groups; -1: an outlier.
  bool inlier = false;               ///< of any group.
};

struct TurntableSolution {
  TurntableMotion motion = TurntableMotion::kTooFewImages;
  std::vector<TurntableGroup> groups;     ///< by size; groups[0] defines the axis. Empty unless it rotates.
  std::vector<TurntableImageFit> images;  ///< in the order of the poses given.
  int reference = -1;                     ///< index of the image with angle 0: the first inlier by name.
  double reference_angle_rad = 0;         ///< its angle between the bases inside; for WorldFromObjectAtAngle.
  double scale = 1;                       ///< lambda: background units per object unit.
  bool scale_observable = false;          ///< false: scale is 1 by definition.
  int num_distinct_stations = 0;          ///< stations whose camera centres differ measurably.
  int sense = 0;                          ///< sign of most steps in order of names about +axis; 0: none.
  double median_step_deg = 0;             ///< of images next to each other by name in one station, signed.

  // Standard deviations; infinite where the data leave no redundancy.
  double rotation_sigma_deg = 0;  ///< of one relative rotation, about one axis.
  double offset_sigma_rel = 0;    ///< of one camera centre, per coordinate (relative as above).
  double axis_sigma_deg = 0;      ///< of the worse direction of n.
  double point_sigma = 0;         ///< of the worse direction of a across the axis, background units.
  double scale_sigma_rel = 0;     ///< sigma_lambda / lambda.

  // What observability was judged by.
  double angle_spread_deg = 0;          ///< circular standard deviation of the table angles.
  std::vector<double> singular_values;  ///< of (3) with columns of unit length, descending.
  double scale_singular_gap = 0;        ///< smallest over second smallest of them; 0: exactly unobservable.
};

/// Solves (2) and (3) robustly: random minimal seeds, then reweighted least squares (Tukey). Survives 30 %
/// wrong poses. The sign of the axis: cameras look down on the table, -n . (mean viewing direction) > 0;
/// when they look level (below 5 degrees), image tops are up.
TurntableSolution SolveTurntable(const std::vector<TurntablePose>& poses,
                                 const TurntableOptions& options = {});

/// The object's place in the background's frame by the fitted motion (x_b = scale R x_o + translation), for
/// the angle theta of `SolveTurntable`'s convention.
Sim3 WorldFromObjectAtAngle(const TurntableSolution& solution, int group, double angle_rad);

}  // namespace s2gs
