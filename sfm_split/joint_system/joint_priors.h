#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <optional>
#include <vector>

#include "sfm_split/joint_system/wobble_harmonics.h"
#include "sfm_split/scene/focal_prior.h"

namespace s2gs {

// What is known of a scan before its keypoints are looked at, as normal distributions beside the reprojection
// errors. Their standard deviations are stated, and the shares of the results' variances that come from them
// are reported.

/// Where a lens' axis meets a photo that was cut, as far as that is known; in either direction.
struct PrincipalPointPrior {
  Eigen::Vector2d mean_px = Eigen::Vector2d::Zero();
  double sigma_px = 0;
};

/// Of one camera.
struct LensPrior {
  FocalPrior focal;
  std::optional<PrincipalPointPrior> principal;  ///< where it is free; nothing: held, unless options free it.
  std::optional<double>
      distortion;  ///< mean of k (DistortionPlace), with kDistortionSigma; nothing: unknown.
};

/// The table angles of one station's images lie about equal steps: angle = offset + step * place, with an
/// error of its own for each image (a motor's, which does not add up; errors that do add up are wider).
struct EqualStepsPrior {
  struct Place {
    int image = 0;
    double steps = 0;  ///< from the station's first photo on, in order of capture.
  };
  std::vector<Place> places;
  bool closes = false;  ///< the step is that of a whole turn; else it is unknown, as the offset always is.
  double offset_rad = 0;
  double step_rad = 0;
  double sigma_rad = 0;  ///< of an angle about equal steps.
};

/// How the table stood at a station's images against how it stood at another's, as silhouettes tell it: the
/// mean of the one's table angles less that of the other's.
struct StationTurnPrior {
  struct Place {
    int image = 0;
    double angle_rad = 0;  ///< table angle; only the difference between the stations is meant.
  };
  std::vector<Place> first;
  std::vector<Place> second;
  double sigma_rad = 0;  ///< of the difference.
};

/// The rim of a round table as one camera place shows it: its picture goes through these places, and it is a
/// circle about the axis, whose height and radius nobody knows.
struct RimPrior {
  int image = 0;                        ///< one of the camera place's.
  std::vector<Eigen::Vector2d> places;  ///< [px]
  double sigma_px = 0;                  ///< of each across the rim, as if they erred by themselves.
  double log_odds = 0;                  ///< logarithm of the odds that edges lie on no such circle by chance.
};

/// Poses of an object that is free of its axis lie about pure turns: a table that wobbles does so by as much
/// at every photo.
struct WobblePrior {
  double sigma_tilt_rad = 0;  ///< of either component across the axis.
  double sigma_shift = 0;     ///< of each coordinate of where the axis' point goes, world units.
  /// Of each station: what its poses lie about in place of pure turns. None: they lie about pure turns.
  std::vector<WobbleHarmonics> harmonics;
  /// Of each of their coefficients about zero. An axis or a camera place that lies elsewhere looks like a
  /// wobble that goes round with the table, or one that stays: nothing else holds these.
  double sigma_harmonic_tilt_rad = 0;
  double sigma_harmonic_shift = 0;
};

struct JointPriors {
  std::vector<LensPrior> lenses;  ///< one per camera, or none at all.
  std::vector<EqualStepsPrior> turns;
  std::vector<StationTurnPrior> station_turns;
  std::vector<RimPrior> rims;         ///< not asked where every image has its own object pose.
  std::optional<WobblePrior> wobble;  ///< where every image has its own object pose.
  /// How much larger variances of the data are than those of independent keypoint errors: the data count by
  /// so much less against the priors. At least 1.
  double data_inflation = 1;
  /// How much larger variances are because poses chose themselves which keypoints are right: what the
  /// residuals say of them is multiplied by it, and the data count by so much less against the priors, too.
  /// At least 1.
  double chosen_variance = 1;
};

}  // namespace s2gs
