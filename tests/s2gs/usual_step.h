#pragma once

#include "s2gs/train_options.h"

namespace s2gs {

/// A step at the rates and with the share of D-SSIM that training has by default; centres at 1e-4, as in the
/// first tenth of it.
inline TrainStep UsualStep() {
  const TrainMoment begin = MomentAt(TrainOptions(), 0, SceneBodies::kBoth, false, false);
  TrainStep step;
  step.rates = begin.rates;
  step.rates.centre = 1e-4F;
  step.weights.dssim = begin.weights.dssim;
  return step;
}

}  // namespace s2gs
