#include "s2gs/training/growth.h"

#include <algorithm>

namespace s2gs {
namespace {

// After a reset every Gaussian is faint: none is removed for it before all photos had their say twice.
double MinOpacity(const TrainRun& run, int64_t num_photos) {
  const TrainCursor& cursor = run.cursor;
  const bool recovers =
      cursor.last_reset > 0 && cursor.iteration - cursor.last_reset < std::max<int64_t>(2 * num_photos, 100);
  return recovers ? std::min(run.options.min_opacity, run.options.opacity_reset_to / 2)
                  : run.options.min_opacity;
}

// The budget is reached when four fifths of the time for growth are over: the last ones need some to learn.
int64_t BudgetAt(double progress, const TrainRun& run) {
  const TrainOptions& options = run.options;
  const double span = 0.8 * (options.densify_until - options.densify_from);
  const double share = std::clamp((progress - options.densify_from) / std::max(span, 1e-9), 0.0, 1.0);
  const auto start = static_cast<double>(run.cursor.initial_count);
  return static_cast<int64_t>(start + share * (static_cast<double>(options.max_gaussians) - start));
}

}  // namespace

int64_t Grow(const TrainMoment& moment, int64_t num_photos, double before, double now, TrainRun* run) {
  if (!moment.grows) return 0;
  const TrainOptions& options = run->options;
  TrainCursor* cursor = &run->cursor;
  int64_t not_finite = 0;
  if (cursor->iteration - cursor->last_densified >= options.densify_every) {
    cursor->last_densified = cursor->iteration;
    DensifyStep step;
    step.iteration = cursor->iteration;
    step.random_seed = cursor->seed;
    step.max_clone_scale = static_cast<float>(options.dense_scale);
    step.max_scale = static_cast<float>(options.max_normalised_scale);
    step.min_opacity = static_cast<float>(MinOpacity(*run, num_photos));
    step.min_gradient = static_cast<float>(options.densify_gradient);
    step.max_count = options.max_gaussians;
    if (options.growth == GrowthStrategy::kBudget) {
      step.min_gradient = 0;
      step.max_count = BudgetAt(now, *run);
    }
    not_finite = run->backend->Densify(step).not_finite;
  }
  if (Passed(before, now, options.opacity_reset_every) && now < options.densify_until - 1e-9) {
    run->backend->ResetOpacity(static_cast<float>(options.opacity_reset_to));
    cursor->last_reset = cursor->iteration;
  }
  return not_finite;
}

}  // namespace s2gs
