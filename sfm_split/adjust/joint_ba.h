#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "sfm_split/base/reporter.h"
#include "sfm_split/joint_system/joint_options.h"
#include "sfm_split/joint_system/joint_problem.h"
#include "sfm_split/joint_system/observability.h"

namespace s2gs {

// The joint adjustment minimises robust reprojection errors of both bodies over station poses, the axis, one
// angle per image, shared intrinsics and all points.
//
// Gauge, fixed explicitly: the pose that the reference image uses is constant (6), the angle of the reference
// image is 0 (1), and one coordinate of the axis' point, the one in which it is farther from the anchor
// camera, is constant (the unit of length). Stations that no background point ties to the anchor can turn
// about the axis with their images' angles: of each set of them the angle of the first image is held. With
// free objects: the anchor's pose and the reference image's object pose are constant, and one coordinate of
// the object pose that moved the anchor farthest relative to the object. An object that moves freely has a
// unit of its own (every image can move it along its rays), so one coordinate of the farthest station's
// centre is constant too, and the scale stays what it was.
//
// Priors (JointPriors) enter as residuals of a standard deviation of a keypoint's coordinate for each of
// their own, without a robust loss, and enter the covariances with the variances that they state.
//
// Observations count by their weights (JointObservation::weight) in the cost, the covariance and the tests'
// number of residuals. The object's are found here (TrackWeights), from 1 on, where covariances are asked
// for: what tells them is what covariances are made of.
//
// The scale lambda of the object against the background is not a parameter of its own: the object's points
// are in the world's unit, so it is the distance of the axis from the anchor over the distance of the anchor
// from the station farthest from it. Its standard deviation is propagated from theirs and depends on no
// gauge.

/// Score of a simple model, whose mean is 1, beyond which a general one is tried. It says what is tried, not
/// what is believed, so that its place is no matter of chance.
inline constexpr double kScoreWorthFitting = 1.5;

/// One comparison of nested models.
struct ModelTest {
  JointModel simple = JointModel::kSharedStations;
  JointModel general = JointModel::kFreeCameras;
  /// Mean over images of the score statistic per parameter: 1 when the simple model is true. The general
  /// model is only fitted when it exceeds 1.5 and a third of what bic_gain asks of each parameter.
  double score = 0;
  std::string worst_image;  ///< the image with the largest score.
  double worst_score = 0;
  bool fitted = false;
  int extra_parameters = 0;
  double f_statistic = 0;  ///< decrease of the cost per extra parameter over the cost per redundancy.
  double bic_gain = 0;     ///< n ln(cost ratio) - k ln n; the general model is taken when positive.
  bool accepted = false;
};

/// Whether principal points, held where they are expected, are free in truth (FitPrincipalPoint).
struct PrincipalPointTest {
  bool fitted = false;  ///< a first look found something to gain.
  /// Twice the logarithm of the odds for free ones, by the Bayesian information criterion.
  double gain = 0;
  double overdispersion = 1;  ///< what the gain is taken over: the photos' scores with free ones.
  Eigen::Vector2d shift = Eigen::Vector2d::Zero();  ///< the farthest, in longer sides of its photos.
  bool accepted = false;
};

struct JointReport {
  JointModel model = JointModel::kSharedStations;
  bool converged = false;
  int iterations = 0;
  double seconds = 0;
  double initial_rms_px = 0;  ///< over the observations active at the start.
  double object_rms_px = 0;   ///< over active observations, both coordinates: sqrt(mean |r|^2).
  double background_rms_px = 0;
  double sigma_px = 0;          ///< robust standard deviation of one coordinate.
  int object_observations = 0;  ///< active at the end.
  int background_observations = 0;
  int removed_observations = 0;
  int undetermined_points = 0;  ///< taken out: too few rays, or all from one place.
  std::string linear_solver;
  std::vector<ModelTest> tests;
  PrincipalPointTest principal_point;
  int harmonics = 0;  ///< stations whose free object poses lie about harmonics (WobbleHarmonics).
  /// The correlation of the errors of the object's points, by which those of few keypoints count less
  /// (TrackWeights).
  double point_correlation = 0;

  // Standard deviations, the largest of those by the covariances, and what wrong observations pull by beyond
  // what noise explains; negative when not computed, infinite when not observable.
  /// The worse direction; of a free object, of the axis that its poses turn about.
  double axis_direction_sigma_deg = -1;
  double axis_point_sigma = -1;  ///< across the axis, the worse direction, world units.
  /// Per image; 0 where held, infinite where no background point ties its station to the reference's.
  std::vector<double> angle_sigma_deg;
  /// Per image, of the object's turn about the axis against the camera, to that at the reference: its points
  /// tell it where nothing tells the table's angle.
  std::vector<double> turn_sigma_deg;
  std::vector<double> focal_sigma_px;  ///< per camera; 0 where held.
  /// Shares of the variances that come from priors (JointPriors), as the above; 0 without. Of an angle whose
  /// station nothing ties: of its variance inside the station.
  std::vector<double> angle_prior_share;
  std::vector<double> focal_prior_share;
  double scale_sigma_rel = -1;
  Observability observability;
};

/// The share of the table angles' variances that comes from priors (median over images with a standard
/// deviation); nothing when there is none.
std::optional<double> AnglePriorShare(const JointReport& report);

/// Adjusts in place. Throws Interrupted when the reporter asks to stop; the problem is then unchanged.
JointReport AdjustJointly(const JointOptions& asked, Reporter& reporter, JointProblem* problem);

/// Takes observations beyond the error bound, behind the camera, and of points that are not determined out of
/// a problem. Returns how many of each.
struct FilterCounts {
  int observations = 0;
  int points = 0;
};
FilterCounts FilterObservations(const JointOptions& options, double max_error_px, JointProblem* problem);

}  // namespace s2gs
