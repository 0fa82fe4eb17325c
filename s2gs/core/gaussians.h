#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace s2gs {

constexpr int kMaxShDegree = 3;
constexpr int kShRestPerChannel = 15;  ///< bands 1 to 3.

/// The model: 2D Gaussian splats, each with a probability p of belonging to the rotating part. Arrays of
/// equal count, one row per Gaussian, in the optimiser's own (unbounded) parameters. Centres and axes are in
/// the object frame, which is the world frame at the reference image: a rotating Gaussian is moved by
/// world_from_object, a static one is not.
struct Gaussians {
  std::vector<float> centre;            ///< 3 per Gaussian: x, scene units.
  std::vector<float> log_scale;         ///< 2: ln s, along the splat's two axes, scene units.
  std::vector<float> rotation;          ///< 4: quaternion r as w, x, y, z, of any length but zero.
  std::vector<float> opacity_logit;     ///< 1
  std::vector<float> sh_dc;             ///< 3: band 0 of R, G, B.
  std::vector<float> sh_rest;           ///< 45: bands 1 to 3; coefficient by coefficient, R G B within each.
  std::vector<float> foreground_logit;  ///< 1: p = sigmoid.
  int sh_degree = 0;                    ///< bands in use, 0 to 3; coefficients beyond are zero.

  size_t size() const { return opacity_logit.size(); }
  bool empty() const { return opacity_logit.empty(); }
  void Resize(size_t count) {
    centre.resize(3 * count);
    log_scale.resize(2 * count);
    rotation.resize(4 * count);
    opacity_logit.resize(count);
    sh_dc.resize(3 * count);
    sh_rest.resize(3 * kShRestPerChannel * count);
    foreground_logit.resize(count);
  }
};

/// The Gaussians of the given indices, in their order; indices may repeat.
Gaussians SelectGaussians(const Gaussians& gaussians, const std::vector<uint32_t>& indices);

/// Floats per Gaussian over all arrays.
constexpr int kFloatsPerGaussian = 3 + 2 + 4 + 1 + 3 + 3 * kShRestPerChannel + 1;

}  // namespace s2gs
