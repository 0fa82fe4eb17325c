#pragma once

#include <algorithm>
#include <cmath>

namespace s2gs {

/// The probability of at least `count` of `of` events, each of which happens with this chance by itself.
inline double BinomialTail(int count, int of, double chance) {
  if (count <= 0 || chance >= 1) return 1;
  if (!(chance > 0)) return 0;
  double sum = 0;
  for (int k = count; k <= of; ++k) {
    sum += std::exp(std::lgamma(of + 1.0) - std::lgamma(k + 1.0) - std::lgamma(of - k + 1.0) +
                    k * std::log(chance) + (of - k) * std::log1p(-chance));
  }
  return std::min(1.0, sum);
}

}  // namespace s2gs
