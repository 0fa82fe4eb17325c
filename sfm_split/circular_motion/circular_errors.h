#pragma once

#include <Eigen/Core>
#include <vector>

#include "sfm_split/circular_motion/circular_likelihood.h"
#include "sfm_split/circular_motion/circular_triples.h"

namespace s2gs {

// How far matches of a station lie from a circle, [px]; infinite where there is no distance.

/// By log focal length, distortion, turn of the frame, angle from the first photo to the second.
using PairDerivative = Eigen::Matrix<double, 6, 1>;

struct PairErrors {
  std::vector<double> errors;
  std::vector<PairDerivative> derivatives;
};

struct RowErrors {
  std::vector<double> errors;
  std::vector<TripleDerivative> derivatives;
};

/// From their epipolar lines. Matches that move farther than the turn can move them have no distance: an axis
/// beside the camera and a turn of next to nothing explain any displacements.
/// \param reach_px  CircularMatches::reach_px.
void ErrorsOf(const CircularMatches::Pair& pair, double reach_px, const CircularLens& lens,
              const CircularTurn& turn, bool with_derivatives, PairErrors* result);

/// TripleErrors() of each.
void ErrorsOf(const CircularMatches::Row& row, const CircularLens& lens, const CircularTurn& turn,
              bool with_derivatives, RowErrors* result);

}  // namespace s2gs
