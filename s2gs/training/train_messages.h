#pragma once

#include <cstdint>
#include <optional>

#include "s2gs/held_out.h"
#include "s2gs/training/train_run.h"

namespace s2gs {

/// What is said of a training while it runs: losses in the log, progress and speed to the user, and an end
/// where losses stay no numbers.
class TrainMessages {
 public:
  /// \param run  outlives this.
  explicit TrainMessages(TrainRun* run) : run_(*run) {}

  /// Before an iteration. Losses of whole photos and of a part of them are no mean of one thing: they are
  /// logged apart. \param draws_part  whether it draws where the rotating part is alone.
  void BeforeStep(bool draws_part);
  /// Gaussians that were removed because their parameters are no numbers.
  void AddNotFinite(int64_t count) { not_finite_ += count; }
  /// After an iteration, when it is due. \param held_out  as measured last.
  /// Throws UserError when losses stay no numbers.
  void ReportIfDue(const std::optional<HeldOutErrors>& held_out, double before, double now);

 private:
  void LogLoss();
  void CheckFinite(const LossTerms& loss);

  TrainRun& run_;
  int64_t not_finite_ = 0;
  int bad_reports_ = 0;
  double last_message_ = 0;  // progress
  bool draws_part_ = false;  // the steps since the last line of losses draw the rotating part alone
  bool has_loss_ = false;    // there are such steps
  LossTerms last_loss_;
};

}  // namespace s2gs
