#pragma once

#include <Eigen/Core>
#include <array>
#include <utility>
#include <vector>

#include "sfm_split/circular_motion/circular_motion.h"

namespace s2gs {

// The likelihood of FitCircularMotion and its maximum from a given start.

/// A camera's two unknowns.
struct CircularLens {
  double log_focal = 0;
  double distortion = 0;  ///< k of r (1 + k r^2).
};

struct CircularTurn {
  Eigen::Matrix3d frame = Eigen::Matrix3d::Identity();  ///< columns p, n x p, n.
  std::vector<double> angles;                           ///< [rad] one per photo, the first 0.
};

struct CircularState {
  std::vector<CircularLens> lenses;
  std::vector<CircularTurn> turns;  ///< one per station.
  double sigma_px = 1;
};

/// A station's matches about the principal point, in pixels of one size in x and y.
struct CircularMatch {
  Eigen::Vector2d first;
  Eigen::Vector2d second;
  double chance = 0;  ///< density of a wrong match's epipolar error [1 / px].
};

/// Keypoints of three photos that matches chain, likewise.
struct CircularTriple {
  std::array<Eigen::Vector2d, 3> xy;
  double chance = 0;  ///< density of a wrong one's error [1 / px].
};

struct CircularMatches {
  int lens = 0;
  int num_photos = 0;
  /// How far a right match moves at most, per chord of a turn on a circle of radius 1 [px]; 0: no bound.
  double reach_px = 0;
  struct Pair {
    int photo1 = 0;
    int photo2 = 0;
    std::vector<CircularMatch> matches;
  };
  std::vector<Pair> pairs;
  struct Row {  // of three photos
    std::array<int, 3> photos{};
    std::vector<CircularTriple> triples;
  };
  std::vector<Row> rows;
};

struct CircularPriors {
  std::vector<FocalPrior> focal;        ///< per lens.
  std::vector<double> least_log_focal;  ///< per lens: bounds, whatever the matches say.
  std::vector<double> most_log_focal;
  std::vector<double> distortion;  ///< per lens: its mean.
  double distortion_sigma = 0;     ///< 0: distortion is held.
  /// Standard deviation of a free angle about equal steps, as a share of the step: tables turn one way, by
  /// hand from mark to mark at worst.
  double angle_share = 0.3;
  std::vector<CircularTurn> angles;  ///< equal steps that free angles lie about; empty: no such prior.
};

/// How steps are free.
enum class CircularSteps {
  kEqualHeld,  ///< the angles stay.
  kEqual,      ///< one step a station, equal ones.
  kFree,       ///< every angle.
};

struct CircularFigures {
  double log_posterior = 0;  ///< of everything, pairs, rows and priors, over chance.
  double sigma_px = 0;       ///< of the matches' errors, by their probabilities to be right.
  double inliers = 0;
  std::vector<double> gain;                        ///< per station, of the pairs.
  std::vector<int> inliers_of_station;             ///< matches rather right than wrong.
  std::vector<std::vector<double>> gain_of_photo;  ///< per station and photo.
};

/// \param with_photos  fill in gain_of_photo.
CircularFigures EvaluateCircular(const std::vector<CircularMatches>& data, const CircularPriors& priors,
                                 const CircularState& state, bool with_photos);

/// Levenberg-Marquardt on the mixture by expectation and maximisation, at the state's sigma. Returns the
/// figures at the end. \param focal_sigma_log  filled in unless null.
CircularFigures RefineCircular(const std::vector<CircularMatches>& data, const CircularPriors& priors,
                               CircularSteps steps, int max_iterations, CircularState* state,
                               std::vector<double>* focal_sigma_log);

/// RefineCircular() and the noise in turns, until neither changes. \param most_sigma_px  of the noise.
CircularFigures SettleCircular(const std::vector<CircularMatches>& data, const CircularPriors& priors,
                               CircularSteps steps, double most_sigma_px, CircularState* state);

/// SettleCircular() with every angle free about those of the state. Returns the logarithm of the posterior
/// less what the Bayesian information criterion charges for them.
double FreeCircularAngles(const std::vector<CircularMatches>& data, CircularPriors priors,
                          double most_sigma_px, CircularState* state);

/// Epipolar errors are the same for an axis on the other side of the camera, with all points behind it. Turns
/// the frame to the side on which more of the station's matches that are right lie before both photos.
void FaceMatches(const CircularMatches& station, const CircularLens& lens, double sigma_px,
                 CircularTurn* turn);

}  // namespace s2gs
