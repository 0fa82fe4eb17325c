#pragma once

#include <map>

namespace s2gs {

/// What the likelihood of all matches, right and wrong ones, says of poses besides.
struct MatchFindings {
  double noise_px = 0;        ///< standard deviation of a right match's epipolar error; 0: not measured.
  double overdispersion = 1;  ///< by how much logarithms of likelihoods are too large.
  /// By station: standard deviation of its turn against the object at the reference's (StationTurns).
  std::map<int, double> turn_sigma_deg;
};

}  // namespace s2gs
