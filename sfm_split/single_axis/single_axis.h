#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "sfm_split/base/error.h"
#include "sfm_split/base/reporter.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

// The turntable from cameras that are known (from the background) and matches on the rotating part, without
// any reconstruction of that part. A ray (d, m = (C - a) x d) of image i, turned by D = theta_j - theta_i
// about the axis (unit n through a), has to meet its partner of image j:
//     d_j . R m_i + m_j . R d_i = alpha + beta cos D + gamma sin D = 0,
//     alpha = (d_j.n)(n.m_i) + (m_j.n)(n.d_i),  beta = d_j.m_i + m_j.d_i - alpha,
//     gamma = n . (m_i x d_j + d_i x m_j).
// With the axis given, one match yields the angle (two roots; in one station one of them is 0 and means
// nothing), so angles are found by letting every match propose and all matches of the pair vote, with
// Sampson's error in pixels and both points in front. The axis (4 numbers) is searched on a coarse grid of
// directions and offsets near where the images look, scored by all pairs' votes together; the best are
// refined with the error bound drawn in. Angles of pairs then become angles of images (spanning tree,
// reweighted least squares around the circle), and axis and angles are adjusted together to all matches. With
// a single camera position the axis is found up to its distance, which is set to 1.

struct SingleAxisImage {
  std::string name;
  int camera = 0;  ///< index into SingleAxisInput::cameras.
  int station = 0;
  Rigid3 cam_from_world;
};

struct SingleAxisPair {
  int image1 = 0;
  int image2 = 0;
  std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> matches;  ///< [px] in image1, image2.
};

struct SingleAxisInput {
  std::vector<Camera> cameras;
  std::vector<SingleAxisImage> images;
  std::vector<SingleAxisPair> pairs;  ///< on the rotating part, outliers included; any order.
};

struct SingleAxisOptions {
  double noise_px = 1;             ///< expected standard deviation of a keypoint; bounds are multiples of it.
  int min_matches = 4;             ///< pairs with fewer are not used.
  int max_search_pairs = 60;       ///< pairs that judge the coarse search.
  int max_search_matches = 24;     ///< matches of each, at random.
  int num_directions = 240;        ///< of the axis, over the half sphere; 240 are about 9 degrees apart.
  int offsets_per_side = 5;        ///< of the axis, across the object.
  int num_refined = 16;            ///< axes of the coarse search that are refined.
  int max_matches = 200;           ///< of a pair in the final adjustment.
  double min_inlier_ratio = 0.15;  ///< of all matches, below which no turntable was found.
  uint32_t random_seed = 0;

  OptionCheck Check() const;
};

struct SingleAxisImageFit {
  bool found = false;    ///< false: no pair with enough agreeing matches ties it to the rest.
  double angle_rad = 0;  ///< about +axis, 0 at the reference, in (-pi, pi].
  double sigma_deg = 0;  ///< standard deviation against the reference.
  int inliers = 0;       ///< matches that agree, over all its pairs.
};

/// Whether a station's steps are equal, tested, never assumed.
struct EqualSteps {
  int station = 0;
  double step_deg = 0;      ///< of the best line through the angles in order of names.
  double rms_deg = 0;       ///< of the angles from that line.
  bool consistent = false;  ///< rms within 3 times what the angles' standard deviations explain.
};

struct SingleAxisSolution {
  bool found = false;
  std::string reason;             ///< when not found.
  TurntableAxis axis;             ///< in the cameras' world; direction as SolveTurntable orients it.
  bool scale_observable = false;  ///< false: all cameras are in one place, distance to the axis set to 1.
  int reference = -1;             ///< the first image by name that was found.
  std::vector<SingleAxisImageFit> images;
  std::vector<std::vector<char>> inliers;  ///< per pair and match.
  double inlier_ratio = 0;
  double sigma_px = 0;                  ///< robust standard deviation of Sampson's error.
  double axis_direction_sigma_deg = 0;  ///< the worse direction.
  double axis_point_sigma = 0;          ///< across the axis, the worse direction.
  std::vector<EqualSteps> steps;        ///< per station with at least 4 images.
  /// Support of the best axis over that of the best one more than 15 degrees away, after refinement; near 1:
  /// ambiguous.
  double margin = 0;

  /// x_in_world = R(axis, angle) (x - point) + point.
  Rigid3 WorldFromObject(int image) const;
};

/// Throws Interrupted when the reporter asks to stop.
SingleAxisSolution SolveSingleAxis(const SingleAxisInput& input, const SingleAxisOptions& options,
                                   Reporter& reporter);

}  // namespace s2gs
