#include "s2gs/train_options.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "sfm_split/base/format_text.h"

namespace s2gs {
namespace {

struct Range {
  const char* field;
  double value;
  double low;
  double high;
  const char* bound;
};

OptionCheck CheckRanges(std::initializer_list<Range> ranges) {
  for (const Range& range : ranges) {
    // Written so that NaN fails.
    if (!(range.value >= range.low && range.value <= range.high)) {
      return OptionFault{range.field, FormatText("%.15g", range.value), range.bound};
    }
  }
  return std::nullopt;
}

constexpr double kNoBound = 1e30;

OptionCheck CheckRates(const TrainOptions& o) {
  return CheckRanges({
      {"centre_rate", o.centre_rate, 0, kNoBound, "centre_rate >= 0"},
      {"final_centre_rate", o.final_centre_rate, 0, o.centre_rate, "0 <= final_centre_rate <= centre_rate"},
      {"scale_rate", o.scale_rate, 0, kNoBound, "scale_rate >= 0"},
      {"rotation_rate", o.rotation_rate, 0, kNoBound, "rotation_rate >= 0"},
      {"opacity_rate", o.opacity_rate, 0, kNoBound, "opacity_rate >= 0"},
      {"sh_dc_rate", o.sh_dc_rate, 0, kNoBound, "sh_dc_rate >= 0"},
      {"sh_rest_rate", o.sh_rest_rate, 0, kNoBound, "sh_rest_rate >= 0"},
      {"foreground_rate", o.foreground_rate, 0, kNoBound, "foreground_rate >= 0"},
  });
}

OptionCheck CheckLoss(const TrainOptions& o) {
  return CheckRanges({
      {"dssim_weight", o.dssim_weight, 0, 1, "0 <= dssim_weight <= 1"},
      {"normal_weight", o.normal_weight, 0, kNoBound, "normal_weight >= 0"},
      {"normal_from", o.normal_from, 0, 1, "0 <= normal_from <= 1"},
      {"distortion_weight", o.distortion_weight, 0, kNoBound, "distortion_weight >= 0"},
      {"distortion_from", o.distortion_from, 0, 1, "0 <= distortion_from <= 1"},
      {"local_consistency_weight", o.local_consistency_weight, 0, kNoBound, "local_consistency_weight >= 0"},
      {"entropy_3d_weight", o.entropy_3d_weight, 0, kNoBound, "entropy_3d_weight >= 0"},
      {"entropy_2d_weight", o.entropy_2d_weight, 0, kNoBound, "entropy_2d_weight >= 0"},
      {"mask_weight", o.mask_weight, 0, kNoBound, "mask_weight >= 0"},
      {"regularise_from", o.regularise_from, 0, 1, "0 <= regularise_from <= 1"},
      {"num_neighbours", static_cast<double>(o.num_neighbours), 1, 64, "1 <= num_neighbours <= 64"},
      {"neighbours_every", o.neighbours_every, 1e-5, 1, "0.00001 <= neighbours_every <= 1"},
  });
}

OptionCheck CheckGrowth(const TrainOptions& o) {
  return CheckRanges({
      {"sh_degree", static_cast<double>(o.sh_degree), 0, kMaxShDegree, "0 <= sh_degree <= 3"},
      {"sh_degree_every", o.sh_degree_every, 0, 1, "0 <= sh_degree_every <= 1"},
      {"max_gaussians", static_cast<double>(o.max_gaussians), 1, 1e9, "1 <= max_gaussians <= 1000000000"},
      {"densify_from", o.densify_from, 0, 1, "0 <= densify_from <= 1"},
      {"densify_until", o.densify_until, 0, 1, "0 <= densify_until <= 1"},
      {"densify_every", static_cast<double>(o.densify_every), 1, kNoBound, "densify_every >= 1"},
      {"densify_gradient", o.densify_gradient, 0, kNoBound, "densify_gradient >= 0"},
      {"dense_scale", o.dense_scale, 0, kNoBound, "dense_scale >= 0"},
      {"min_opacity", o.min_opacity, 0, 0.99, "0 <= min_opacity <= 0.99"},
      {"opacity_reset_every", o.opacity_reset_every, 0, 1, "0 <= opacity_reset_every <= 1"},
      {"opacity_reset_to", o.opacity_reset_to, 1e-4, 0.99, "0.0001 <= opacity_reset_to <= 0.99"},
      {"max_normalised_scale", o.max_normalised_scale, 0, kNoBound, "max_normalised_scale >= 0"},
  });
}

OptionCheck CheckCourse(const TrainOptions& o) {
  return CheckRanges({
      {"num_iterations", static_cast<double>(o.num_iterations), 1, 1e9, "1 <= num_iterations <= 1000000000"},
      {"max_seconds", o.max_seconds, 0, kNoBound, "max_seconds >= 0"},
      {"stop_gain_pct", o.stop_gain_pct, 0, 100, "0 <= stop_gain_pct <= 100"},
      {"settle_from", o.settle_from, 0, 1, "0 <= settle_from <= 1"},
      {"settle_until", o.settle_until, o.settle_from, 1, "settle_from <= settle_until <= 1"},
      {"settled_share", o.settled_share, 0, 1, "0 <= settled_share <= 1"},
      {"unseen_weight", o.unseen_weight, 0, 1, "0 <= unseen_weight <= 1"},
      {"unseen_static_weight", o.unseen_static_weight, 0, 1, "0 <= unseen_static_weight <= 1"},
      {"coarse_levels", static_cast<double>(o.coarse_levels), 0, 6, "0 <= coarse_levels <= 6"},
      {"coarse_until", o.coarse_until, 0, 1, "0 <= coarse_until <= 1"},
      {"min_coarse_size", static_cast<double>(o.min_coarse_size), 16, kNoBound, "min_coarse_size >= 16"},
      {"whole_every", static_cast<double>(o.whole_every), 1, 1e9, "1 <= whole_every <= 1000000000"},
      {"checkpoint_every", o.checkpoint_every, 0, 1, "0 <= checkpoint_every <= 1"},
      {"num_measurements", static_cast<double>(o.num_measurements), 0, 1000, "0 <= num_measurements <= 1000"},
  });
}

}  // namespace

OptionCheck TrainOptions::Check() const {
  for (const auto& check : {CheckRates, CheckLoss, CheckGrowth, CheckCourse}) {
    if (OptionCheck fault = check(*this)) return fault;
  }
  return initial.Check();
}

int64_t TimesBy(double progress, double every) {
  if (!(every > 0)) return 0;
  return static_cast<int64_t>(std::floor(progress / every + 1e-9));
}

TrainMoment MomentAt(const TrainOptions& options, double progress, SceneBodies bodies, bool foreground_frozen,
                     bool has_masks) {
  TrainMoment moment;
  moment.progress = progress;
  moment.sh_degree =
      options.sh_degree_every > 0
          ? static_cast<int>(std::min<int64_t>(options.sh_degree, TimesBy(progress, options.sh_degree_every)))
          : options.sh_degree;
  if (options.coarse_levels > 0 && progress < options.coarse_until) {
    // Levels take equal shares of the time until full size.
    const double share = progress / options.coarse_until;
    moment.coarse_level = options.coarse_levels - static_cast<int>(share * options.coarse_levels);
  }

  const double log_rate = (1 - progress) * std::log(std::max(options.centre_rate, 1e-30)) +
                          progress * std::log(std::max(options.final_centre_rate, 1e-30));
  LearningRates& rates = moment.rates;
  rates.centre = static_cast<float>(std::exp(log_rate));
  rates.log_scale = static_cast<float>(options.scale_rate);
  rates.rotation = static_cast<float>(options.rotation_rate);
  rates.opacity = static_cast<float>(options.opacity_rate);
  rates.sh_dc = static_cast<float>(options.sh_dc_rate);
  rates.sh_rest = static_cast<float>(options.sh_rest_rate);
  const bool learns_foreground = bodies == SceneBodies::kBoth && !foreground_frozen;
  rates.foreground = learns_foreground ? static_cast<float>(options.foreground_rate) : 0;

  LossWeights& weights = moment.weights;
  weights.dssim = static_cast<float>(options.dssim_weight);
  if (progress >= options.normal_from) weights.normal = static_cast<float>(options.normal_weight);
  // While p is learnt, depths of either body may be far off: drawing them together would settle p by chance.
  if (!learns_foreground && progress >= options.distortion_from) {
    weights.distortion = static_cast<float>(options.distortion_weight);
  }
  if (learns_foreground && progress >= options.regularise_from) {
    weights.local_consistency = static_cast<float>(options.local_consistency_weight);
    weights.entropy_3d = static_cast<float>(options.entropy_3d_weight);
    weights.entropy_2d = static_cast<float>(options.entropy_2d_weight);
  }
  if (learns_foreground && has_masks) weights.mask = static_cast<float>(options.mask_weight);
  moment.grows = progress >= options.densify_from && progress < options.densify_until;
  return moment;
}

}  // namespace s2gs
