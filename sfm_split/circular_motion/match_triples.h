#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "sfm_split/scene/scan_features.h"

namespace s2gs {

/// Keypoints of three photos that matches chain.
struct MatchTriple {
  std::array<uint32_t, 3> point2D_idx{};
  double chance = 0;  ///< density of the middle one's place if they are wrong [1 / px]; 0: not asked for.
};

/// Those of three photos in a row.
struct PhotoTriple {
  int station = 0;
  std::array<int, 3> places{};  ///< in the station's order.
  std::array<int, 3> images{};  ///< indices into the features' images.
  std::vector<MatchTriple> matches;
};

/// Points that three photos in a row of one station show, in the features' order and from the last photo on
/// to the first, by all matches that may be the object's, right and wrong ones.
std::vector<PhotoTriple> PhotoTriples(const ScanFeatures& features);

/// The same, with what chance makes of each (WrongMiddles, of its station).
std::vector<PhotoTriple> PossibleTriples(const ScanFeatures& features);

/// [px]
std::array<Eigen::Vector2d, 3> KeypointsOf(const ScanFeatures& features, const PhotoTriple& photos,
                                           const MatchTriple& match);

/// Of three keypoints that matches chain.
struct MiddleMove {
  double move_px = 0;  ///< of the outer ones.
  double off_px = 0;   ///< how far the middle one lies from half of it, along it.
};

MiddleMove MiddleOf(const std::array<Eigen::Vector2d, 3>& xy);

/// Where the middle keypoints of wrong matches fall along their outer ones' moves. Not anywhere: what stands
/// still or slides over a surface lies half-way between, wherever the table turned, so that nothing that
/// tells no more has anything to gain.
class WrongMiddles {
 public:
  /// \param middles  of a station, right ones and wrong.
  explicit WrongMiddles(const std::vector<MiddleMove>& middles);

  /// Density of the middle keypoint's place, for three that moved so [1 / px]. From several threads.
  double Chance(const MiddleMove& middle) const;

 private:
  std::vector<double> off_px_;  // in order
};

/// Of the middle keypoint against the one that the outer two tell, over that of a keypoint.
inline constexpr double kNoiseOfMiddle = 1.2247448713915890;  // the square root of 1 + 1/2

}  // namespace s2gs
