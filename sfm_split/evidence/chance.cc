#include "sfm_split/evidence/chance.h"

#include <algorithm>
#include <cmath>

namespace s2gs {

int64_t LeastAgreeingMatches(int64_t all, double by_chance, double hypotheses, double risk) {
  const double p = std::clamp(by_chance, 0.0, 1.0);
  if (p >= 1) return all + 1;
  const auto n = static_cast<double>(all);
  double tail = 0;
  // From the rarest count down, so that the tail is a sum from its small terms to its large ones.
  for (int64_t k = all; k >= 0; --k) {
    const auto agreeing = static_cast<double>(k);
    const double log_ways = std::lgamma(n + 1) - std::lgamma(agreeing + 1) - std::lgamma(n - agreeing + 1);
    const double log_agreeing = k == 0 ? 0 : agreeing * std::log(p);
    tail += std::exp(log_ways + log_agreeing + (n - agreeing) * std::log1p(-p));
    if (tail * hypotheses > risk) return k + 1;
  }
  return 0;
}

}  // namespace s2gs
