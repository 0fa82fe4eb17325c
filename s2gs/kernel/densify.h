#pragma once

#include <cmath>
#include <cstdint>

#include "s2gs/core/rng.h"
#include "s2gs/core/vec.h"
#include "s2gs/kernel/constants.h"
#include "s2gs/kernel/foreground.h"
#include "s2gs/kernel/surfel.h"

namespace s2gs {

/// What adaptive density control does with one Gaussian.
enum class DensifyAction : uint8_t {
  kKeep,
  kClone,     ///< keep, and add a copy.
  kSplit,     ///< replace by two smaller ones, drawn from it.
  kRemove,    ///< too faint or too large.
  kNotFinite  ///< removed because a parameter is NaN or infinite.
};

/// The thresholds of one densification.
struct DensifyRule {
  float min_gradient;
  float max_clone_scale;
  float max_scale;  ///< 0: none.
  float min_opacity;
  bool grow;
};

constexpr float kSplitScaleRatio = 1.6F;  ///< of a parent's scale over its two children's.

/// Mean length of the gradient by the centre on screen over the views that saw the Gaussian.
S2GS_HD inline float MeanGradient(float gradient_sum, float view_count) {
  const float mean = view_count > 0 ? gradient_sum / view_count : 0.0F;
  return mean >= 0 ? mean : 0.0F;  // NaN counts as none.
}

/// \param is_finite  whether all parameters are, those of the colour included.
S2GS_HD inline DensifyAction DecideDensify(const SurfelParameters<float>& g, bool is_finite,
                                           float mean_gradient, const DensifyRule& rule) {
  if (!is_finite || !IsDrawable(g)) return DensifyAction::kNotFinite;
  if (Sigmoid(g.opacity_logit) < rule.min_opacity) return DensifyAction::kRemove;
  const float log_scale = g.log_scale.x > g.log_scale.y ? g.log_scale.x : g.log_scale.y;
  const float scale = std::exp(log_scale);
  const bool grows = rule.grow && mean_gradient >= rule.min_gradient;
  const bool splits = grows && scale > rule.max_clone_scale;
  if (rule.max_scale > 0 && (splits ? scale / kSplitScaleRatio : scale) > rule.max_scale) {
    return DensifyAction::kRemove;
  }
  return splits ? DensifyAction::kSplit : grows ? DensifyAction::kClone : DensifyAction::kKeep;
}

/// Centre and log-scales of one of the two children of a split.
/// \param parent  index of the parent before the densification.
/// \param child   0 or 1.
S2GS_HD inline void SplitChild(const SurfelParameters<float>& g, uint64_t seed, int64_t iteration,
                               uint64_t parent, int child, Vec3<float>* centre, Vec2<float>* log_scale) {
  const Random4 bits =
      RandomBits(seed, static_cast<uint64_t>(iteration), 2 * parent + static_cast<uint64_t>(child));
  // Box and Muller; 1 - u lies in (0, 1].
  const float radius = std::sqrt(-2 * std::log(1 - UnitFloat(bits.words[0])));
  const float angle = 6.2831853F * UnitFloat(bits.words[1]);
  const float length2 = g.rotation.w * g.rotation.w + g.rotation.x * g.rotation.x +
                        g.rotation.y * g.rotation.y + g.rotation.z * g.rotation.z;
  const Mat3<float> rotation = RotationMatrix(g.rotation, 1 / std::sqrt(length2));
  *centre = g.centre + (radius * std::cos(angle) * std::exp(g.log_scale.x)) * rotation.x +
            (radius * std::sin(angle) * std::exp(g.log_scale.y)) * rotation.y;
  constexpr float kLogRatio = 0.47000363F;  // ln 1.6
  *log_scale = {g.log_scale.x - kLogRatio, g.log_scale.y - kLogRatio};
}

}  // namespace s2gs
