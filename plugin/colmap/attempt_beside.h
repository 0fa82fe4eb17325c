#pragma once

#include <functional>

#include "sfm_split/base/reporter.h"

namespace s2gs {

/// Work that an attempt may make needless.
struct NeedlessWork {
  /// With a reporter that asks it to stop once it is needless.
  std::function<void(Reporter&)> work;
  /// Takes away what it left, whether it had ended or not.
  std::function<void()> undo;
};

/// Makes an attempt, and does the work unless that succeeds: beside it where the machine has cores for both,
/// else after it. The attempt has a thread of its own then, and what it logs is logged when it has ended.
/// What the attempt comes to does not depend on the work, and where it succeeds the work leaves nothing and
/// what it throws counts for nothing: which of the two ends first makes no difference. \param num_threads
/// that the machine has for this. \return  whether the attempt succeeded. Throws what it throws, and what the
/// work throws where it is needed.
bool AttemptBeside(const std::function<bool(Reporter&)>& attempt, const NeedlessWork& needless,
                   int num_threads, Reporter& reporter);

}  // namespace s2gs
