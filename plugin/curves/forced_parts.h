#pragma once

#include <filesystem>
#include <limits>
#include <optional>
#include <ostream>
#include <string>
#include <vector>

#include "plugin/curves/sweep.h"
#include "plugin/curves/work_curve.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// What a part that a scan's plan leaves out would have cost and gained.
struct ForcedPart {
  std::string scene;
  std::string part;  ///< of PlanParts().
  std::string what;
  std::string error_text;  ///< what the errors are, with their unit.
  /// Of the seeds that have an error as planned and with the part; infinite where none has both.
  int seeds = 0;
  Spread planned_error, forced_error;
  Spread planned_cpu_seconds, forced_cpu_seconds;  ///< of the commands from the part's stage on.
  /// Errors that differ by less than this say nothing, in their unit; NaN: unknown. Where they are of
  /// rotations against a truth, the standard deviation that the adjustment as planned gives the camera's tilt
  /// against the axis: all photos of a station share the tilt, so that the error of a scan's poses is a
  /// single draw of it. Elsewhere, from three seeds on, the standard error of the mean difference of runs of
  /// one seed.
  double gain_sigma = std::numeric_limits<double>::quiet_NaN();
  std::optional<double> mean_gain;  ///< of the seeds, in the errors' unit, where gain_sigma is of them.
  std::string failure;              ///< of a run of it, or of the run as planned; empty: none failed.

  /// By how much forcing it lowers the median error; below 0: it raises it [%].
  double GainPct() const;
  /// The same in gain_sigma; of means where that is of seeds.
  double GainSigmas() const;
};

/// Runs as planned and with parts forced.
struct ForcedRuns {
  std::vector<WorkCurve> curves;  ///< of the scans' stages: poses, training, mesh.

  /// Of all curves, scene by scene.
  std::vector<ForcedPart> Parts() const;
};

/// Runs each part that the plan of a finished scan leaves out, and that can be forced, with every seed: the
/// stages from the part's command on, as RunSweep() does, once as planned and once for each part. Resumable.
/// \param options  scenes, seeds, arguments (of all commands that have the option: COMMAND.NAME=VALUE), GPU,
/// jobs,
///                 program; the knob and its values do not count.
/// \param parts    only these; empty: all that are left out.
ForcedRuns MeasureForcedParts(const SweepOptions& options, const std::vector<std::string>& parts,
                              Reporter& reporter);

/// Runs of other scenes, seeds or parts as one. Throws UserError where two have the same run.
ForcedRuns MergeForcedRuns(const std::vector<ForcedRuns>& all);

/// One line a part.
void WriteForcedCsv(const std::vector<ForcedPart>& parts, std::ostream& out);
/// {"version": 1, "program", "parts": [...], "curves": [as WriteCurveJson()]}.
void WriteForcedJson(const ForcedRuns& runs, std::ostream& out);
/// What WriteForcedJson() wrote. Throws UserError for any other file.
ForcedRuns ReadForced(const std::filesystem::path& path);
void PrintForcedParts(const std::vector<ForcedPart>& parts, std::ostream& out);

}  // namespace s2gs
