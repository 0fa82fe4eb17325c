#include "s2gs/settle.h"

#include <cmath>

#include "s2gs/gaussians_ply.h"
#include "s2gs/kernel/foreground.h"

namespace s2gs {
namespace {

constexpr float kLogitOfNine = 2.1972246F;  // p = .9
constexpr float kFrozenLogit = 10;          // p within 5e-5 of 0 or 1.

Eigen::Vector3d CentreOf(const Gaussians& gaussians, size_t i) {
  return {gaussians.centre[3 * i], gaussians.centre[3 * i + 1], gaussians.centre[3 * i + 2]};
}

bool StraysOutside(const Gaussians& gaussians, size_t i, const RotatingRegion& region, double margin) {
  return IsForeground(gaussians.foreground_logit[i]) && !region.Contains(CentreOf(gaussians, i), margin);
}

}  // namespace

double SettledShare(const Gaussians& gaussians) {
  if (gaussians.empty()) return 1;
  size_t settled = 0;
  for (const float logit : gaussians.foreground_logit) settled += std::abs(logit) > kLogitOfNine ? 1 : 0;
  return static_cast<double>(settled) / static_cast<double>(gaussians.size());
}

TrainState SelectState(const TrainState& state, const std::vector<uint32_t>& indices) {
  const auto select = [&](const std::vector<float>& values) {
    std::vector<float> chosen;
    if (values.empty()) return chosen;
    chosen.reserve(indices.size());
    for (const uint32_t index : indices) chosen.push_back(values[index]);
    return chosen;
  };
  TrainState chosen;
  chosen.gaussians = SelectGaussians(state.gaussians, indices);
  if (!state.first_moment.empty()) {
    chosen.first_moment = SelectGaussians(state.first_moment, indices);
    chosen.second_moment = SelectGaussians(state.second_moment, indices);
  }
  chosen.gradient_sum = select(state.gradient_sum);
  chosen.view_count = select(state.view_count);
  return chosen;
}

void FreezeForeground(TrainState* state) {
  for (float& logit : state->gaussians.foreground_logit) {
    logit = IsForeground(logit) ? kFrozenLogit : -kFrozenLogit;
  }
  for (float& value : state->first_moment.foreground_logit) value = 0;
  for (float& value : state->second_moment.foreground_logit) value = 0;
}

std::vector<uint32_t> KeepInsideRegion(const Gaussians& gaussians, const RotatingRegion& region,
                                       double margin) {
  std::vector<uint32_t> kept;
  kept.reserve(gaussians.size());
  for (size_t i = 0; i < gaussians.size(); ++i) {
    if (!StraysOutside(gaussians, i, region, margin)) kept.push_back(static_cast<uint32_t>(i));
  }
  return kept;
}

int64_t DisownOutsideRegion(const RotatingRegion& region, double margin, TrainState* state) {
  int64_t disowned = 0;
  for (size_t i = 0; i < state->gaussians.size(); ++i) {
    if (!StraysOutside(state->gaussians, i, region, margin)) continue;
    ++disowned;
    state->gaussians.foreground_logit[i] = 0;
    if (state->first_moment.empty()) continue;
    state->first_moment.foreground_logit[i] = 0;
    state->second_moment.foreground_logit[i] = 0;
  }
  return disowned;
}

}  // namespace s2gs
