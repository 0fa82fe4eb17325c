#pragma once

#include <cstddef>
#include <optional>
#include <random>

#include "sfm_split/circular_motion/circular_likelihood.h"
#include "sfm_split/circular_motion/circular_motion.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

/// Whether circular motion can be fitted to what such a camera sees: its distortion is radial at most.
bool IsPerspective(CameraModelId model);

/// A station's matches as seen from the principal point, with each one's density if it is wrong: at most
/// options.max_matches of a pair, drawn at random. `lens` is the station's camera. Nothing when the station
/// has too little to fit, or no perspective camera.
std::optional<CircularMatches> MatchesOfStation(const CircularStation& station, const Camera& camera,
                                                const CircularOptions& options, std::mt19937* rng);

/// Of the matches of photos a few steps apart some `num`, around the circle, evenly.
CircularMatches SampleMatches(const CircularMatches& all, size_t num);

}  // namespace s2gs
