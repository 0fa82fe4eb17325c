#pragma once

#include <vector>

#include "sfm_split/adjust/match_errors.h"
#include "sfm_split/adjust/track_triangulation.h"

namespace s2gs {

/// Times the bound within which matches agree, over which their errors are looked at for noise.
constexpr double kNoiseRange = 6;

/// Errors as a mixture of noise and of outliers.
struct NoiseFit {
  double sigma = 0;         ///< standard deviation of the noise, in the errors' unit.
  double inlier_share = 0;  ///< share of the errors up to `range` that are noise.
};

/// Fits |N(0, sigma)| beside outliers spread evenly over [0, range] to absolute errors, by expectation and
/// maximisation. Unlike a spread measured within a bound, sigma does not shrink to the bound; it is at most
/// range / 3. Errors beyond `range` and those that are not finite are left out; nothing left gives zeros.
NoiseFit FitNoise(const std::vector<double>& errors, double range);

/// The same for the matches of posed images: their Sampson errors [px], whose standard deviation is that of a
/// keypoint's coordinate, enlarged by what the poses are wrong by. At most `max_matches` are looked at,
/// evenly. \param errors  of matches against these images' poses.
NoiseFit MeasureMatchNoise(const std::vector<PosedImage>& images, const MatchErrors& errors,
                           const std::vector<ImagePairMatches>& pairs, double range_px,
                           size_t max_matches = 50000);

}  // namespace s2gs
