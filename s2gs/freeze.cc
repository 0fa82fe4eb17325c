#include "s2gs/freeze.h"

#include <cmath>

#include "s2gs/kernel/foreground.h"

namespace s2gs {
namespace {

constexpr float kLogitOfNine = 2.1972246F;  // p = .9
constexpr float kFrozenLogit = 10;          // p within 5e-5 of 0 or 1.

bool StraysOutside(const Placement& placement, size_t i, const RotatingRegion& region, double margin) {
  const float* x = placement.centre.data() + 3 * i;
  return IsForeground(placement.foreground_logit[i]) && !region.Contains({x[0], x[1], x[2]}, margin);
}

}  // namespace

double SettledShare(const std::vector<float>& foreground_logits) {
  if (foreground_logits.empty()) return 1;
  size_t settled = 0;
  for (const float logit : foreground_logits) settled += std::abs(logit) > kLogitOfNine ? 1 : 0;
  return static_cast<double>(settled) / static_cast<double>(foreground_logits.size());
}

void FreezeForeground(std::vector<float>* foreground_logits) {
  for (float& logit : *foreground_logits) logit = IsForeground(logit) ? kFrozenLogit : -kFrozenLogit;
}

std::vector<uint32_t> KeepInsideRegion(const Placement& placement, const RotatingRegion& region,
                                       double margin) {
  std::vector<uint32_t> kept;
  kept.reserve(placement.size());
  for (size_t i = 0; i < placement.size(); ++i) {
    if (!StraysOutside(placement, i, region, margin)) kept.push_back(static_cast<uint32_t>(i));
  }
  return kept;
}

int64_t DisownOutsideRegion(const RotatingRegion& region, double margin, Placement* placement) {
  int64_t disowned = 0;
  for (size_t i = 0; i < placement->size(); ++i) {
    if (!StraysOutside(*placement, i, region, margin)) continue;
    ++disowned;
    placement->foreground_logit[i] = 0;
  }
  return disowned;
}

}  // namespace s2gs
