#pragma once

#include <ostream>

#include "plugin/curves/work_curve.h"

namespace s2gs {

/// One self-contained HTML file, light and dark, without scripts or requests: for each scene the error over
/// CPU and over wall time, log over log, the median of the seeds with least to largest, runs without a result
/// in a band of their own, the Pareto set filled; a table of the settings; time to 90, 99 and 99.9 % of the
/// final quality; and, with several scenes, performance profiles.
void WriteCurvePage(const WorkCurve& curve, std::ostream& out);

}  // namespace s2gs
