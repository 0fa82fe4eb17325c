#pragma once

#include <cstdint>
#include <filesystem>
#include <istream>
#include <ostream>
#include <string>

#include "s2gs/backend/backend.h"
#include "s2gs/held_out_course.h"

namespace s2gs {

/// What training needs beyond the backend's state to go on as if it had never stopped. Random numbers have no
/// state: they follow from the seed and the iteration.
struct TrainCursor {
  int64_t iteration = 0;  ///< finished.
  double progress = 0;    ///< of the run's course, 0 to 1.
  uint64_t seed = 0;
  double wall_seconds = 0;       ///< of training, without measuring.
  double cpu_seconds = 0;        ///< likewise.
  double measuring_seconds = 0;  ///< wall time of measuring.
  bool foreground_frozen = false;
  int64_t last_densified = 0;    ///< iteration.
  int64_t last_reset = 0;        ///< of opacities; iteration, 0: none yet.
  int64_t initial_count = 0;     ///< of Gaussians, before any growth.
  int64_t neighbours_turn = -1;  ///< of the schedule, when they were found last.
  int64_t num_unseen_static =
      0;  ///< Gaussians that stood still and were removed because no photo shows them.
  HeldOutCourse held_out_course;
  std::string settings;  ///< fingerprint of options and scene: another one refuses to resume.
};

struct Checkpoint {
  TrainCursor cursor;
  TrainState state;
};

/// A binary file: magic, version, length and XXH3 of what follows, then the content, little-endian. The path
/// form is atomic.
void WriteCheckpoint(const std::filesystem::path& path, const Checkpoint& checkpoint);
void WriteCheckpoint(std::ostream& stream, const Checkpoint& checkpoint);

/// Throws UserError with path and offset when the file is truncated, damaged, of another version or claims
/// counts that it cannot hold.
/// \param path  for the stream form: for messages only.
Checkpoint ReadCheckpoint(const std::filesystem::path& path);
Checkpoint ReadCheckpoint(std::istream& stream, const std::filesystem::path& path);

}  // namespace s2gs
