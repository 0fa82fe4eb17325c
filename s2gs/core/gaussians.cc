#include "s2gs/core/gaussians.h"

namespace s2gs {

Gaussians SelectGaussians(const Gaussians& gaussians, const std::vector<uint32_t>& indices) {
  const auto select = [&](const std::vector<float>& rows, size_t width) {
    std::vector<float> selected;
    selected.reserve(width * indices.size());
    for (const uint32_t index : indices) {
      const auto begin = rows.begin() + static_cast<std::ptrdiff_t>(width * index);
      selected.insert(selected.end(), begin, begin + static_cast<std::ptrdiff_t>(width));
    }
    return selected;
  };
  Gaussians chosen;
  chosen.centre = select(gaussians.centre, 3);
  chosen.log_scale = select(gaussians.log_scale, 2);
  chosen.rotation = select(gaussians.rotation, 4);
  chosen.opacity_logit = select(gaussians.opacity_logit, 1);
  chosen.sh_dc = select(gaussians.sh_dc, 3);
  chosen.sh_rest = select(gaussians.sh_rest, 3 * kShRestPerChannel);
  chosen.foreground_logit = select(gaussians.foreground_logit, 1);
  chosen.sh_degree = gaussians.sh_degree;
  return chosen;
}

}  // namespace s2gs
