#pragma once

#include <cstdint>

#include "s2gs/backend/backend.h"
#include "s2gs/initialise.h"
#include "sfm_split/base/error.h"

namespace s2gs {

/// How the model grows.
enum class GrowthStrategy : uint8_t {
  kAdaptive,  ///< every Gaussian whose gradient on screen is large, as 2DGS.
  kBudget,    ///< the Gaussians of largest gradient, as many as keep the count on the way to a fixed budget.
};

/// Everything that training can be told. Moments are shares of the run (0 its begin, 1 its end), so that a
/// run of another length has the same course; the defaults are those of 2DGS and of the S2GS paper over
/// 30,000 iterations. Lengths are in scene sizes (TrainingScene::size).
// NOLINTNEXTLINE(clang-analyzer-optin.performance.Padding): fields stand by topic.
struct TrainOptions {
  // Length.
  int64_t num_iterations = 30'000;
  double max_seconds = 0;  ///< 0: no bound. Otherwise the whole course is run through in this time at most.
  /// Training stops when the error of held-out photos, falling on as it fell and with the scatter that it
  /// has, would surely lose less than this share of itself over the rest of the run [%]
  /// (HeldOutCourse::MostGainToComePct); 0: never. Not before the model has stopped growing and p is settled,
  /// and not with fewer than HeldOutCourse::kMinPhotos held out. Off by default: it has to measure them.
  double stop_gain_pct = 0;

  // Start.
  InitialiseOptions initial;

  // Learning rates.
  double centre_rate = 1.6e-4;  ///< at the begin [scene sizes].
  double final_centre_rate = 1.6e-6;
  double scale_rate = 0.005;
  double rotation_rate = 0.001;
  double opacity_rate = 0.05;
  double sh_dc_rate = 0.0025;
  double sh_rest_rate = 0.000125;
  double foreground_rate = 0.05;

  // Loss.
  double dssim_weight = 0.2;
  double normal_weight = 0.05;
  double normal_from = 7.0 / 30;
  double distortion_weight = 0;
  double distortion_from = 3.0 / 30;
  double local_consistency_weight = 0.1;
  double entropy_3d_weight = 1;
  double entropy_2d_weight = 0.1;
  double mask_weight = 0.1;  ///< where photos have masks, in mode S2GS with masks as a hint.
  double regularise_from = 5.0 / 30;
  int num_neighbours = 5;
  double neighbours_every = 1.0 / 60;  ///< they are found anew this often, and when the model grew.

  // Colour.
  int sh_degree = 3;
  double sh_degree_every = 1.0 / 30;
  bool only_told_bands = true;  ///< bands that no training photo tells from lower ones are left out.

  // Growth.
  GrowthStrategy growth = GrowthStrategy::kAdaptive;
  int64_t max_gaussians = 2'000'000;  ///< the bound, or with `budget` the count at the end of growth.
  double densify_from = 0.5 / 30;
  double densify_until = 0.5;
  int densify_every = 100;  ///< [iterations]
  double densify_gradient = 2e-4;
  double dense_scale = 0.01;  ///< larger Gaussians are split, others cloned [scene sizes].
  double min_opacity = 0.05;
  double opacity_reset_every = 0;  ///< 0: never. 2DGS: 0.1.
  double opacity_reset_to = 0.01;

  // Segmentation.
  double settle_from = 0.4;         ///< from here on p is frozen once it has settled,
  double settle_until = 0.6;        ///< and at the latest here. 1: never.
  double settled_share = 0.995;     ///< of the Gaussians' p outside [.1, .9]: settled.
  bool use_rotating_region = true;  ///< nothing outside the rotating points' cylinder rotates.
  bool use_turn_evidence = true;    ///< nothing rotates where photos show the background (turn_evidence.h).
  double unseen_weight =
      0.02;  ///< frozen foreground that is never blended with more than this goes; 0: stays.
  /// The same for what stands still: less than half a grey level of 8 bits, which no photo shows.
  double unseen_static_weight = 0.5 / 255;

  // Whole frames.
  /// Once p is frozen and growth is over: in one of so many rounds through the photos whole frames are drawn
  /// and learnt from, in the others only the tiles that the rotating part reaches. 1: whole frames always.
  int whole_every = 1;

  // Resolution.
  int coarse_levels = 2;      ///< training starts at 1 / 2^n of the photos' size.
  double coarse_until = 0.2;  ///< when the full size is reached.
  int min_coarse_size = 96;   ///< no level has a longer side below this [px].

  // Care.
  /// Of the run, where 30 s or more would be lost; 0: only when interrupted.
  double checkpoint_every = 0.2;
  int num_measurements = 12;        ///< of the held-out photos, at log-spaced moments from 1 % on; 0: none.
  double max_normalised_scale = 0;  ///< larger Gaussians are removed; 0: none [scene sizes].

  OptionCheck Check() const;
};

/// Where a run stands: what holds at one moment of its course.
struct TrainMoment {
  double progress = 0;  ///< 0 to 1.
  int sh_degree = 0;
  int coarse_level = 0;  ///< photos are reduced by 2^level.
  LearningRates rates;
  LossWeights weights;
  bool grows = false;
};

/// The schedules. \param bodies  decides which of the losses exist.
TrainMoment MomentAt(const TrainOptions& options, double progress, SceneBodies bodies, bool foreground_frozen,
                     bool has_masks);

/// How often something that happens `every` share of the run has happened by `progress`; 0 when `every` is 0.
int64_t TimesBy(double progress, double every);

}  // namespace s2gs
