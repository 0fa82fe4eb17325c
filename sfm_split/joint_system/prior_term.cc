#include "sfm_split/joint_system/prior_term.h"

#include <cmath>
#include <cstddef>

namespace s2gs {

double PriorTerm::Residual(const std::vector<double>& values, std::vector<double>* derivatives) const {
  if (function) {
    const double residual = function(values, derivatives) - mean;
    for (size_t k = 0; derivatives != nullptr && k < derivatives->size(); ++k)
      (*derivatives)[k] *= scale_px / sigma;
    return residual * scale_px / sigma;
  }
  double sum = -mean;
  if (derivatives != nullptr) derivatives->resize(parts.size());
  for (size_t k = 0; k < parts.size(); ++k) {
    sum += parts[k].factor * (of_logarithms ? std::log(values[k]) : values[k]);
    if (derivatives == nullptr) continue;
    (*derivatives)[k] = parts[k].factor * (of_logarithms ? 1 / values[k] : 1) * scale_px / sigma;
  }
  return sum * scale_px / sigma;
}

}  // namespace s2gs
