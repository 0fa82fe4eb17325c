#pragma once

#include <cstdint>
#include <future>
#include <optional>
#include <vector>

#include "s2gs/core/pinhole_view.h"
#include "s2gs/training/train_run.h"
#include "s2gs/turn_evidence.h"

namespace s2gs {

/// Freezes p, and removes what does not belong to its body: Gaussians that rotate where nothing does or where
/// photos show the background, and those that no photo shows.
class ModelCleanup {
 public:
  /// Begins to look at the photos beside the steps where a GPU leaves the cores idle. \param run  outlives
  /// this.
  explicit ModelCleanup(TrainRun* run);

  /// Once p has settled, or its time is up. Progress `before` and after (`now`) the last iteration.
  void FreezeIfDue(double before, double now);
  /// \param views  of the training photos at their present size.
  void TidyIfDue(const std::vector<PinholeView>& views, double before, double now);
  /// At the end: logs what the photos tell of the rotating part's pixels.
  void LogSights();

 private:
  bool UsesEvidence() const;
  void TakeEvidence();
  void Freeze(Placement placement, double share, double now);
  void RemoveStanding();
  void RemoveUnseen(const std::vector<PinholeView>& views, const Placement& placement,
                    std::vector<uint32_t>* kept);
  void LogUnseen(int64_t count, int64_t of);

  TrainRun& run_;
  std::optional<TurnEvidence> evidence_;  // taken, or made, when it is first asked.
  std::future<TurnEvidence> evidence_to_come_;
};

}  // namespace s2gs
