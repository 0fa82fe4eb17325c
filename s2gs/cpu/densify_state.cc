#include "s2gs/cpu/densify_state.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "s2gs/kernel/densify.h"

namespace s2gs {
namespace {

SurfelParameters<float> LoadSurfel(const Gaussians& g, size_t i) {
  return {{g.centre[3 * i], g.centre[3 * i + 1], g.centre[3 * i + 2]},
          {g.log_scale[2 * i], g.log_scale[2 * i + 1]},
          {g.rotation[4 * i], g.rotation[4 * i + 1], g.rotation[4 * i + 2], g.rotation[4 * i + 3]},
          g.opacity_logit[i],
          g.foreground_logit[i]};
}

bool AllFinite(const std::vector<float>& rows, size_t width, size_t i) {
  for (size_t j = 0; j < width; ++j) {
    if (!std::isfinite(rows[width * i + j])) return false;
  }
  return true;
}

bool IsFinite(const Gaussians& g, size_t i) {
  return AllFinite(g.centre, 3, i) && AllFinite(g.log_scale, 2, i) && AllFinite(g.rotation, 4, i) &&
         AllFinite(g.opacity_logit, 1, i) && AllFinite(g.sh_dc, 3, i) &&
         AllFinite(g.sh_rest, 3 * kShRestPerChannel, i) && AllFinite(g.foreground_logit, 1, i);
}

bool Survives(DensifyAction action) {
  return action != DensifyAction::kRemove && action != DensifyAction::kNotFinite;
}
bool Grows(DensifyAction action) {
  return action == DensifyAction::kClone || action == DensifyAction::kSplit;
}

// Lets only the largest gradients grow, as many as there is room for.
void BoundGrowth(const TrainState& state, const std::vector<float>& gradient, const DensifyRule& rule,
                 int64_t max_count, std::vector<DensifyAction>* actions) {
  int64_t surviving = 0;
  std::vector<uint32_t> growing;
  growing.reserve(actions->size());
  for (size_t i = 0; i < actions->size(); ++i) {
    surviving += Survives((*actions)[i]) ? 1 : 0;
    if (Grows((*actions)[i])) growing.push_back(static_cast<uint32_t>(i));
  }
  const auto room = static_cast<size_t>(std::max<int64_t>(0, max_count - surviving));
  if (growing.size() <= room) return;
  std::stable_sort(growing.begin(), growing.end(),
                   [&](uint32_t a, uint32_t b) { return gradient[a] > gradient[b]; });
  DensifyRule without_growth = rule;
  without_growth.grow = false;
  for (size_t j = room; j < growing.size(); ++j) {
    const uint32_t i = growing[j];
    (*actions)[i] = DecideDensify(LoadSurfel(state.gaussians, i), true, gradient[i], without_growth);
  }
}

void SetChild(const DensifyStep& step, const SurfelParameters<float>& parent, uint64_t parent_index,
              int child, size_t at, Gaussians* gaussians) {
  Vec3<float> centre{};
  Vec2<float> log_scale{};
  SplitChild(parent, step.random_seed, step.iteration, parent_index, child, &centre, &log_scale);
  gaussians->centre[3 * at] = centre.x;
  gaussians->centre[3 * at + 1] = centre.y;
  gaussians->centre[3 * at + 2] = centre.z;
  gaussians->log_scale[2 * at] = log_scale.x;
  gaussians->log_scale[2 * at + 1] = log_scale.y;
}

void ForgetMoments(size_t at, TrainState* state) {
  if (state->first_moment.empty()) return;
  for (Gaussians* moment : {&state->first_moment, &state->second_moment}) {
    const auto clear = [at](std::vector<float>* rows, size_t width) {
      std::fill_n(rows->begin() + static_cast<std::ptrdiff_t>(width * at), width, 0.0F);
    };
    clear(&moment->centre, 3);
    clear(&moment->log_scale, 2);
    clear(&moment->rotation, 4);
    clear(&moment->opacity_logit, 1);
    clear(&moment->sh_dc, 3);
    clear(&moment->sh_rest, 3 * kShRestPerChannel);
    clear(&moment->foreground_logit, 1);
  }
}

}  // namespace

DensifyResult DensifyState(const DensifyStep& step, TrainState* state) {
  const size_t count = state->gaussians.size();
  const DensifyRule rule = {step.min_gradient, step.max_clone_scale, step.max_scale, step.min_opacity,
                            step.grow};
  std::vector<float> gradient(count, 0.0F);
  std::vector<DensifyAction> actions(count);
  for (size_t i = 0; i < count; ++i) {
    if (!state->gradient_sum.empty())
      gradient[i] = MeanGradient(state->gradient_sum[i], state->view_count[i]);
    actions[i] =
        DecideDensify(LoadSurfel(state->gaussians, i), IsFinite(state->gaussians, i), gradient[i], rule);
  }
  if (step.max_count > 0) BoundGrowth(*state, gradient, rule, step.max_count, &actions);

  // Survivors in order, then what was added.
  std::vector<uint32_t> sources;
  std::vector<uint32_t> added;
  sources.reserve(count);
  added.reserve(count);
  DensifyResult result;
  for (size_t i = 0; i < count; ++i) {
    const DensifyAction action = actions[i];
    result.cloned += action == DensifyAction::kClone ? 1 : 0;
    result.split += action == DensifyAction::kSplit ? 1 : 0;
    result.removed += action == DensifyAction::kRemove ? 1 : 0;
    result.not_finite += action == DensifyAction::kNotFinite ? 1 : 0;
    if (!Survives(action)) continue;
    sources.push_back(static_cast<uint32_t>(i));
    if (Grows(action)) added.push_back(static_cast<uint32_t>(i));
  }
  const size_t num_survivors = sources.size();
  sources.insert(sources.end(), added.begin(), added.end());
  TrainState next = SelectState(*state, sources);
  for (size_t at = 0; at < sources.size(); ++at) {
    const uint32_t source = sources[at];
    const bool is_added = at >= num_survivors;
    if (actions[source] == DensifyAction::kSplit) {
      SetChild(step, LoadSurfel(state->gaussians, source), source, is_added ? 1 : 0, at, &next.gaussians);
    }
    if (is_added || actions[source] == DensifyAction::kSplit) ForgetMoments(at, &next);
  }
  next.num_neighbours = state->num_neighbours;
  next.gradient_sum.assign(sources.size(), 0.0F);
  next.view_count.assign(sources.size(), 0.0F);
  *state = std::move(next);
  result.count = static_cast<int64_t>(state->gaussians.size());
  return result;
}

}  // namespace s2gs
