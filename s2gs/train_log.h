#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "s2gs/backend/backend.h"
#include "s2gs/held_out.h"
#include "s2gs/turn_evidence.h"

namespace s2gs {

/// What every line of the log has.
struct LogPoint {
  int64_t iteration = 0;
  double progress = 0;           ///< 0 to 1.
  double wall_seconds = 0;       ///< of training, without measuring.
  double cpu_seconds = 0;        ///< of all threads, likewise.
  double measuring_seconds = 0;  ///< wall time of measuring so far.
  int64_t count = 0;             ///< of Gaussians.
  int width = 0, height = 0;     ///< of the first photo at the present resolution [px].
};

/// What was left out, or kept, by a measurement in the course of training, in words for people.
struct TrainDecision {
  std::string part;  ///< as the plan names it.
  bool is_left_out = false;
  std::string measured, threshold, reason, saving;
};

/// W/s2gs/log.jsonl: one JSON object a line, "stage": "train" in each. "event" is "loss" (the means of the
/// loss terms since the line before, "whole": whether over whole photos), "held_out", "sights", "decision" or
/// "note". Kept in memory and written as a whole, atomically.
class TrainLog {
 public:
  /// \param path       empty: nothing is written.
  /// \param iteration  of the checkpoint that training goes on from: later lines of an existing log are
  ///                   dropped. Below 0: the log starts anew.
  TrainLog(std::filesystem::path path, int64_t iteration);

  /// \param sees_whole_photos  false: of iterations that drew where the rotating part is alone
  /// (TrainOptions::whole_every).
  void AddLoss(const LogPoint& point, const LossTerms& loss, bool sees_whole_photos);
  void AddHeldOut(const LogPoint& point, const HeldOutErrors& errors);
  void AddSights(const LogPoint& point, const SightShares& shares);
  void AddNote(const LogPoint& point, const std::string& note);
  void AddDecision(const LogPoint& point, const TrainDecision& decision);
  /// Throws UserError when the file cannot be written.
  void Write() const;

 private:
  std::filesystem::path path_;
  std::vector<std::string> lines_;
};

}  // namespace s2gs
