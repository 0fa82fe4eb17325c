#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "plugin/curves/knobs.h"
#include "plugin/curves/work_curve.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// A finished scan whose stages are run again.
struct SweptScene {
  std::filesystem::path workspace;
  std::filesystem::path image_path;    ///< empty: images in the workspace.
  std::filesystem::path ground_truth;  ///< empty: against the scan's own longest run.
};

struct SweepOptions {
  Knob knob;
  std::vector<SweptScene> scenes;
  std::vector<std::string> values;  ///< from cheap to costly; empty: the knob's.
  std::vector<uint64_t> seeds = {0};
  std::vector<std::string> arguments;  ///< more options for the knob's command, as NAME=VALUE; {workspace} is
                                       ///< the scan's folder.
  std::string use_gpu = "auto";
  int jobs = 1;                   ///< runs at a time.
  bool keep_files = false;        ///< of every run; else what comparisons need.
  std::filesystem::path program;  ///< that runs the stages; empty: this one.
};

/// Runs every value with every seed on every scene, each in a workspace of its own in
/// WORKSPACE/work_precision/KNOB, and measures what came out. Runs that are done are taken as they are; a run
/// that fails is a point without result. Without ground truth, poses and meshes are measured against the last
/// value's run of the same seed, which is the ruler and no point of the curve; training is measured on photos
/// held out, which needs no reference. Throws UserError for options that cannot be run, Interrupted when the
/// reporter asks to stop: the same call goes on.
WorkCurve RunSweep(const SweepOptions& options, Reporter& reporter);

}  // namespace s2gs
