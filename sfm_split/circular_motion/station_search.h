#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/reporter.h"
#include "sfm_split/circular_motion/circular_likelihood.h"
#include "sfm_split/circular_motion/circular_motion.h"
#include "sfm_split/scene/focal_prior.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

/// e^8 to one: what is believed against chance.
inline constexpr double kBeyondChance = 8;

/// From where a fit of circular motion begins, or has come to.
struct CircularStart {
  double log_posterior = 0;  ///< less what the Bayesian information criterion charges for free angles.
  double log_prior = 0;      ///< of what is known of cameras' places before the matches; part of the above.
  bool is_closed = false;
  size_t view = 0;  ///< which side of the picture is up, and which way the table turns.
  CircularSteps steps = CircularSteps::kEqual;
  CircularState state;
};

/// Works on each start by itself, from several threads. Throws Interrupted when the reporter asks to stop.
template <typename Work>
void ForEachStart(std::vector<CircularStart>* starts, Reporter& reporter, const Work& work) {
  ParallelFor(static_cast<int64_t>(starts->size()), 0, [&](int64_t i) {
    if (reporter.StopRequested()) throw Interrupted();
    work(&(*starts)[static_cast<size_t>(i)]);
  });
}

/// Of one station, each with equal steps; both or neither.
struct StationStarts {
  std::optional<CircularStart> closed;  ///< the best where the steps close after the station's photos.
  std::optional<CircularStart> open;    ///< the best where they are of any size.
  size_t num_tried = 0;                 ///< of which these are the best: chance had as many.
};

/// Begins with all sides that may be up, elevations, both senses of turning and several focal lengths.
/// Nothing where there is nothing to start from. \param data  the station's matches.
/// Throws Interrupted when the reporter asks to stop.
StationStarts SearchStation(const CircularMatches& data, const Camera& camera, const FocalPrior& prior,
                            const CircularOptions& options, Reporter& reporter);

}  // namespace s2gs
