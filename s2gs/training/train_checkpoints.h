#pragma once

#include <cstdint>

#include "s2gs/training/train.h"
#include "s2gs/training/train_run.h"

namespace s2gs {

struct TrainStart {
  TrainCursor cursor;
  bool resumed = false;  ///< training goes on from before.
};

/// Loads the checkpoint into the backend, or makes the first Gaussians there. A checkpoint that cannot be
/// read is set aside under another name, for who wants to look at it.
TrainStart StartOrResume(const TrainingScene& scene, const TrainOptions& options, uint64_t seed,
                         const TrainFiles& files, Backend* backend, Reporter& reporter);

/// Writes the checkpoint now and then, and when the user asks to stop.
class TrainCheckpoints {
 public:
  /// Both outlive this.
  TrainCheckpoints(const TrainFiles& files, TrainRun* run)
      : files_(files), run_(*run), saved_at_(run->cursor.wall_seconds) {}

  /// Throws Interrupted when the user asks to stop. Progress `before` and after (`now`) the last iteration.
  void SaveIfDue(double before, double now);

 private:
  void Save();

  const TrainFiles& files_;
  TrainRun& run_;
  double saved_at_;  // of the wall time of training [s]
};

}  // namespace s2gs
