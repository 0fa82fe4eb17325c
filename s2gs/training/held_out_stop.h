#pragma once

#include <optional>

#include "s2gs/held_out.h"
#include "s2gs/training/train_run.h"

namespace s2gs {

/// Measures photos held out of training in its course, and says when their error has stopped falling.
class HeldOutStop {
 public:
  /// \param run  outlives this.
  explicit HeldOutStop(TrainRun* run);

  /// Logs why training will run to its end, where that is known from the start.
  void LogWhetherItMayStop();
  /// At its moments, evenly spread over the logarithm of the course. Progress `before` and after (`now`) the
  /// last iteration.
  void MeasureIfDue(double before, double now);
  /// Whether the rest of the run would only polish: the model has stopped growing, p is settled and the error
  /// no longer falls.
  bool HasStoppedFalling(double before, double now);

  /// As measured last.
  const std::optional<HeldOutErrors>& errors() const { return errors_; }

 private:
  bool MayStop() const;
  void Measure();
  void LogEnd(double now, bool stops);

  TrainRun& run_;
  int num_photos_ = 0;  // held out
  std::optional<HeldOutErrors> errors_;
};

}  // namespace s2gs
