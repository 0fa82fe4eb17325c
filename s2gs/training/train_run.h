#pragma once

#include <filesystem>

#include "s2gs/backend/backend.h"
#include "s2gs/checkpoint.h"
#include "s2gs/scene/training_scene.h"
#include "s2gs/train_log.h"
#include "s2gs/train_options.h"
#include "s2gs/training/train_clock.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// One training, as its parts share it: what is trained, by what, and how far it is.
struct TrainRun {
  /// All that is referred to outlives the run. \param resumed  whether it goes on after the cursor's
  /// iteration.
  TrainRun(const TrainingScene& trained, const TrainOptions& told, Backend* by, Reporter& to,
           const TrainCursor& from, bool resumed, const std::filesystem::path& log_path);
  TrainRun(const TrainRun&) = delete;
  TrainRun& operator=(const TrainRun&) = delete;

  /// Where the log stands now.
  LogPoint Point() const;
  /// By the iterations and, where a time is given, by that [0 to 1].
  double Progress() const;

  const TrainingScene& scene;
  const TrainOptions& options;
  Backend* backend;
  Reporter& reporter;
  TrainCursor cursor;
  TrainLog log;
  TrainClock clock;
  int width = 0, height = 0;  ///< of the first photo at the present resolution [px].
};

/// Whether a moment of the schedule lies between two points of the course. \param every  a share of the run.
bool Passed(double before, double now, double every);

}  // namespace s2gs
