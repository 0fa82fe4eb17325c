#pragma once

#include "s2gs/checkpoint.h"

namespace s2gs {

/// Adds to the cursor's seconds those of training and, apart from them, those of measuring.
class TrainClock {
 public:
  /// \param cursor  outlives the clock.
  explicit TrainClock(TrainCursor* cursor);

  /// Adds what passed since the last call of either as training.
  void Lap();
  /// Adds it as measuring, whose CPU seconds nobody counts.
  void LapMeasuring();
  /// Of training until now [s].
  double WallSeconds() const;

 private:
  void Advance(double* wall, double* cpu);

  TrainCursor* cursor_;
  double wall_;  // of the last call [s]
  double cpu_;   // of all threads, likewise
};

}  // namespace s2gs
