#pragma once

#include <cstdint>

#include "s2gs/core/gaussians.h"
#include "s2gs/scene/training_scene.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

enum class InitialPoints : uint8_t {
  kSparse,  ///< the sparse models' points, filled up with random ones where they are too few.
  kRandom,  ///< the paper's: a random cube of the rotating part's size and a sphere of 4 times its side.
};

struct InitialiseOptions {
  InitialPoints init = InitialPoints::kSparse;
  int64_t num_random_points = 100'000;  ///< with kRandom.
  int64_t min_points = 3000;            ///< with kSparse: filled up to this many for each body.
  int64_t max_points = 1'000'000;       ///< of a larger model every n-th point is taken.
  double opacity = 0.1;                 ///< of every Gaussian.
  double random_foreground = 0.5;       ///< p of random Gaussians.
  double sparse_foreground = 0.9;       ///< p of the rotating part's points; the background's is 1 minus it.
  double background_radius_sides = 4;   ///< radius of the random sphere in sides of the random cube.

  OptionCheck Check() const;
};

/// The first Gaussians of a training, in the scene's normalised lengths: scales from the distance to the
/// three nearest others, random orientations, colours of the points, even grey for random ones. The same seed
/// gives the same Gaussians on every machine and for any number of threads.
Gaussians InitialiseGaussians(const TrainingScene& scene, const InitialiseOptions& options, uint64_t seed,
                              Reporter& reporter);

}  // namespace s2gs
