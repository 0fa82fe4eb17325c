#pragma once

#include <limits>
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
  Spread planned_error, forced_error;
  Spread planned_cpu_seconds, forced_cpu_seconds;  ///< of the commands from the part's stage on.
  /// The standard deviation that the adjustment as planned gives the camera's tilt against the axis, in the
  /// unit of the errors, where these are of rotations against a truth; else NaN. All photos of a station
  /// share the tilt, so that the error of a scan's poses is a single draw of it: errors that differ by less
  /// say nothing.
  double planned_sigma = std::numeric_limits<double>::quiet_NaN();
  std::string failure;  ///< why there is no forced error; empty: there is one.

  /// By how much forcing it lowers the median error; below 0: it raises it [%].
  double GainPct() const;
  /// The same in planned_sigma.
  double GainSigmas() const;
};

/// Runs each part that the plan of a finished scan leaves out, and that can be forced, with every seed: the
/// stages from the part's command on, as RunSweep() does, once as planned and once for each part. Resumable.
/// \param options  scenes, seeds, arguments (of all commands that have the option: COMMAND.NAME=VALUE), GPU,
/// jobs,
///                 program; the knob and its values do not count.
/// \param parts    only these; empty: all that are left out.
std::vector<ForcedPart> MeasureForcedParts(const SweepOptions& options, const std::vector<std::string>& parts,
                                           Reporter& reporter);

/// One line a part.
void WriteForcedCsv(const std::vector<ForcedPart>& parts, std::ostream& out);
/// {"version": 1, "program", "parts": [...]}.
void WriteForcedJson(const std::vector<ForcedPart>& parts, std::ostream& out);
void PrintForcedParts(const std::vector<ForcedPart>& parts, std::ostream& out);

}  // namespace s2gs
