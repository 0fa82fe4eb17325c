#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>

#include "s2gs/backend/backend.h"
#include "s2gs/core/gaussians.h"
#include "s2gs/held_out.h"
#include "s2gs/scene/training_scene.h"
#include "s2gs/train_options.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// What training writes while it runs. Empty paths: nothing.
struct TrainFiles {
  std::filesystem::path checkpoint;
  std::filesystem::path log;
  std::string settings;  ///< fingerprint of options and scene; a checkpoint with another one is not resumed.
  bool resume = true;    ///< go on from the checkpoint, if there is one.
};

struct TrainResult {
  Gaussians gaussians;  ///< in the scene's normalised lengths.
  int64_t iterations = 0;
  double wall_seconds = 0;  ///< of training, without measuring, over all resumed parts.
  double cpu_seconds = 0;
  double measuring_seconds = 0;
  bool foreground_frozen = false;
  std::optional<HeldOutErrors> held_out;  ///< at the end, when photos are held out and it was asked for.
};

/// Trains a model of the scene. With the CPU backend the result depends on scene, options and seed alone, not
/// on the number of threads or on having been interrupted (unless `max_seconds` is set).
/// Throws Interrupted after writing a checkpoint when the reporter asks to stop, and UserError when numbers
/// stay NaN.
TrainResult Train(const TrainingScene& scene, const TrainOptions& options, uint64_t seed,
                  const TrainFiles& files, Backend* backend, Reporter& reporter);

}  // namespace s2gs
