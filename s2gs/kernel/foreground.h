#pragma once

#include <cmath>

#include "s2gs/core/host_device.h"
#include "s2gs/kernel/constants.h"

namespace s2gs {

/// How a Gaussian's p enters the image.
enum class ForegroundRule {
  kSoft,    ///< p = sigmoid(logit): learnt.
  kHard,    ///< P = [p >= tau] in its place: settled.
  kObject,  ///< 1 for all.
  kStatic,  ///< 0 for all.
};

template <typename T>
S2GS_HD inline T Sigmoid(const T& logit) {
  using std::exp;
  if (logit >= T(0)) return T(1) / (T(1) + exp(-logit));
  const T e = exp(logit);
  return e / (T(1) + e);
}

/// Derivative of Sigmoid, without cancellation at either end.
template <typename T>
S2GS_HD inline T SigmoidSlope(const T& logit) {
  return Sigmoid(logit) * Sigmoid(-logit);
}

/// P of (8). ln(tau / (1 - tau)) is compared with the logit itself, so that no rounding of p moves the
/// border.
template <typename T>
S2GS_HD inline bool IsForeground(const T& logit, ForegroundRule rule = ForegroundRule::kSoft) {
  constexpr double kThresholdLogit = 1.3862943611198906;  // ln 4, for tau = 0.8
  static_assert(kForegroundThreshold == 0.8, "kThresholdLogit belongs to 0.8");
  if (rule == ForegroundRule::kObject) return true;
  if (rule == ForegroundRule::kStatic) return false;
  return logit >= T(kThresholdLogit);
}

/// p as it enters the centre (7) and the rendered map of p.
template <typename T>
S2GS_HD inline T ForegroundProbability(const T& logit, ForegroundRule rule) {
  if (rule == ForegroundRule::kSoft) return Sigmoid(logit);
  return T(IsForeground(logit, rule) ? 1 : 0);
}

/// ln(1 + e^-|x|)
template <typename T>
S2GS_HD inline T Log1pExpOfMinus(const T& x) {
  using std::exp;
  using std::log1p;
  return log1p(exp(x >= T(0) ? -x : x));
}

/// (11): entropy of p = sigmoid(logit) in nats.
template <typename T>
S2GS_HD inline T EntropyOfLogit(const T& logit) {
  const T x = logit >= T(0) ? logit : -logit;
  return Log1pExpOfMinus(x) + x * Sigmoid(-x);
}
template <typename T>
S2GS_HD inline T EntropyOfLogitAdjoint(const T& logit) {
  return -logit * SigmoidSlope(logit);
}

/// (10): KL divergence of Bernoulli(sigmoid(a)) from Bernoulli(sigmoid(b)), in nats.
template <typename T>
S2GS_HD inline T KlOfLogits(T a, T b) {
  // KL(a, b) = KL(-a, -b); with a <= 0 nothing large cancels.
  if (a > T(0)) {
    a = -a;
    b = -b;
  }
  const T kl = Sigmoid(a) * (a - b) + (b > T(0) ? b : T(0)) + (Log1pExpOfMinus(b) - Log1pExpOfMinus(a));
  return kl > T(0) ? kl : T(0);
}
/// Its derivatives by a and b.
template <typename T>
S2GS_HD inline void KlOfLogitsAdjoint(const T& a, const T& b, T* by_a, T* by_b) {
  *by_a = SigmoidSlope(a) * (a - b);
  // sigmoid(b) - sigmoid(a), from the tails where both are near 1.
  *by_b = a > T(0) && b > T(0) ? Sigmoid(-a) - Sigmoid(-b) : Sigmoid(b) - Sigmoid(a);
}

/// (12): entropy of a pixel of the rendered map of p. The map may leave [0, 1] by rounding: constant there.
template <typename T>
S2GS_HD inline T EntropyOfProbability(const T& p) {
  using std::log;
  constexpr double kEdge = 1e-6;
  const T m = p < T(kEdge) ? T(kEdge) : p > T(1 - kEdge) ? T(1 - kEdge) : p;
  return -(m * log(m) + (T(1) - m) * log(T(1) - m));
}
template <typename T>
S2GS_HD inline T EntropyOfProbabilityAdjoint(const T& p) {
  using std::log;
  constexpr double kEdge = 1e-6;
  if (!(p > T(kEdge)) || !(p < T(1 - kEdge))) return T(0);
  return log((T(1) - p) / p);
}

/// Cross entropy of a pixel of the map of p against a mask (1 rotating part, 0 not). The offset bounds the
/// gradient where the map is wrong and leaves it pointing the right way.
constexpr double kMaskOffset = 1e-3;
template <typename T>
S2GS_HD inline T MaskCrossEntropy(const T& p, bool is_inside) {
  using std::log;
  const T likely = is_inside ? p : T(1) - p;
  return -log((likely > T(0) ? likely : T(0)) + T(kMaskOffset));
}
template <typename T>
S2GS_HD inline T MaskCrossEntropyAdjoint(const T& p, bool is_inside) {
  const T likely = is_inside ? p : T(1) - p;
  if (!(likely > T(0))) return is_inside ? T(-1 / kMaskOffset) : T(1 / kMaskOffset);
  return (is_inside ? T(-1) : T(1)) / (likely + T(kMaskOffset));
}

}  // namespace s2gs
