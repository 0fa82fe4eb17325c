#pragma once

#include <string>
#include <vector>

#include "plugin/report/report_input.h"

namespace s2gs {

/// How far a scan's poses can be trusted.
struct ScanVerdict {
  enum class Grade { kUnknown, kGood, kDoubtful, kFailed };
  Grade grade = Grade::kUnknown;
  std::vector<std::string> reasons;
  std::vector<std::string> advice;  ///< what to photograph or run differently.
};

/// "unknown", "good", "doubtful", "failed".
const char* GradeName(ScanVerdict::Grade grade);

/// What turntable_mapper wrote into its report as "verdict", "reasons" and "advice". Where a workspace has
/// none, from what else stands there: failed without a pose; doubtful when a direction of the solution is
/// undetermined, the adjustment did not settle, more than a tenth of the photos has no pose, or the worst
/// table angle is not known to a tenth of a step; else good.
ScanVerdict JudgeScan(const ReportInput& input);

}  // namespace s2gs
