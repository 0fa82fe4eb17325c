#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "plugin/batch/batch_list.h"
#include "plugin/batch/batch_record.h"
#include "plugin/colmap/child_process.h"
#include "sfm_split/base/error.h"

namespace s2gs {

struct BatchRunOptions {
  int jobs = 1;                   ///< objects at the same time.
  std::vector<int32_t> gpus;      ///< numbers of the GPUs that jobs take in turn; empty: what each finds.
  std::filesystem::path program;  ///< this one.
  /// Scans end at a safe point; until then they may take longer than COLMAP does.
  StopGrace grace{std::chrono::seconds(60), std::chrono::seconds(10)};

  OptionCheck Check() const;
};

/// Something that happened to an object.
struct BatchEvent {
  size_t object = 0;  ///< its place among the objects.
  bool has_begun = false;
  bool has_ended = false;
  BatchOutcome outcome;  ///< when it has ended.
  std::string line;      ///< of its output, neither at its beginning nor at its end.
};

/// Scans objects, each by `program automatic_scanner` in a process of its own, whose output is kept as
/// s2gs/batch.log and how it ended as s2gs/batch.json in the object's workspace. Objects in whose workspace
/// another process works are left to it. Jobs share the cores.
/// \param chosen          places among `objects`, of rows without fault, in the order in which they begin.
/// \param on_event        called by this thread.
/// \param stop_requested  polled by this thread. Once true, no object begins, all that run are interrupted,
///                        and Interrupted is thrown when they have ended.
/// Throws UserError when a process cannot be started.
void RunBatch(const std::vector<BatchObject>& objects, const std::vector<size_t>& chosen,
              const BatchRunOptions& options, const std::function<void(const BatchEvent&)>& on_event,
              const std::function<bool()>& stop_requested);

}  // namespace s2gs
