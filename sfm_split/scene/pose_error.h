#pragma once

#include <Eigen/Core>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "sfm_split/base/rigid3.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

/// How much of a similarity the given points determine.
enum class FitStatus {
  kOk,          ///< all seven numbers.
  kCollinear,   ///< the scale alone: two places, or all on a line.
  kCoincident,  ///< nothing: all points of one set at one place, or fewer than two points.
  kNotFinite,   ///< nothing: a point is NaN or infinite.
};

/// A phrase for messages, e.g. "the cameras stand on one line".
std::string_view Describe(FitStatus status);

/// A similarity fitted to point pairs.
struct Sim3Fit {
  FitStatus status = FitStatus::kCoincident;
  Sim3 b_from_a;  ///< defined when kOk; its scale also when kCollinear.

  bool HasScale() const { return status == FitStatus::kOk || status == FitStatus::kCollinear; }
};

/// The similarity that minimises the sum of squared distances |x_in_b - b_from_a * x_in_a| (Umeyama, "Least-
/// squares estimation of transformation parameters between two point patterns", PAMI 1991). Reflections are
/// excluded. Where the points leave the similarity open, the status says so and no arbitrary one is returned.
/// \param min_extent_in_b  points of b within this distance of their mean (root mean square) are one place.
Sim3Fit FitSim3(const std::vector<Eigen::Vector3d>& x_in_a, const std::vector<Eigen::Vector3d>& x_in_b,
                double min_extent_in_b = 0);

/// Camera poses by image name: `cam_from_frame`.
using PoseMap = std::map<std::string, Rigid3>;

/// Errors of camera poses after a similarity fit of the camera centres.
struct PoseErrors {
  Sim3Fit truth_from_estimate;        ///< `b_from_a`: b the truth's frame, a the estimate's.
  std::vector<std::string> names;     ///< the images that both have.
  std::vector<double> rotation_deg;   ///< per name [degrees]; empty unless the fit's status is kOk.
  std::vector<double> centre_length;  ///< per name, in the truth's unit of length; empty likewise.
};

/// \param min_extent  in the truth's unit of length, as in FitSim3.
PoseErrors ComparePoses(const PoseMap& estimate, const PoseMap& truth, double min_extent = 0);

/// The angle of a rotation, 0 to 180 [degrees], accurate also near 0.
double RotationAngleDeg(const Eigen::Quaterniond& rotation);

/// Errors of turntable angles after the mean offset is removed (as a circular mean). The estimate's own axis
/// is taken from its rotations, in whichever of the two senses has the smaller median error. \param
/// estimated_world_from_object, true_world_from_object  one per image, in the same order. \param true_axis in
/// the true world frame, of any length but 0. \return  per image [degrees]; empty when there are fewer than
/// two images.
std::vector<double> TurntableAngleErrorsDeg(
    const std::vector<Eigen::Quaterniond>& estimated_world_from_object,
    const std::vector<Eigen::Quaterniond>& true_world_from_object, const Eigen::Vector3d& true_axis);

struct AxisError {
  double direction_deg = 0;  ///< angle between the two lines, 0 to 90: the direction's sign does not count.
  double offset = 0;  ///< distance of the true axis point from the estimated line, in the truth's unit.
};

/// \param truth_from_estimate  between the frames that the two axes are given in.
AxisError CompareAxes(const TurntableAxis& estimate, const TurntableAxis& truth,
                      const Sim3& truth_from_estimate);

/// Relative pose errors as in COLMAP's reconstruction benchmark: for each pair of images of the truth the
/// larger of the rotation error and the angle between the directions of translation [degrees]; 180 when one
/// of the two images has no estimate. Needs no alignment. \param min_baseline  for pairs whose true centres
/// are no further apart, only the rotation counts.
std::vector<double> RelativePoseErrorsDeg(const PoseMap& estimate, const PoseMap& truth,
                                          double min_baseline = 0);

/// Area under the curve of recall over error from 0 to `threshold`, divided by `threshold`: 1 when every
/// error is 0, 0 when none is below the threshold or there are none. The curve is linear between the sorted
/// errors.
double AreaUnderRecall(std::vector<double> errors, double threshold);

}  // namespace s2gs
