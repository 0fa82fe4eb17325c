#pragma once

#include <cstdint>
#include <filesystem>
#include <string>

#include "sfm_split/base/reporter.h"

namespace s2gs {

/// What a file or a folder with everything below it looked like at one moment. Hidden files (names that begin
/// with a point) do not count.
struct Fingerprint {
  bool exists = false;
  uint64_t num_files = 0;  ///< 1 for a file.
  uint64_t num_bytes = 0;  ///< of all files.
  /// Of names, sizes, modification and change times: equal means unchanged, without reading the files. Empty
  /// when something changed so recently that its next change could bear the same time.
  std::string state;
  /// Of names and contents (XXH3, 64 bits). Empty when it was not asked for.
  std::string content;
};

/// Looks at `path` without reading files; `content` stays empty. Throws UserError when a folder cannot be
/// listed.
Fingerprint TakeState(const std::filesystem::path& path);

/// Reads all files. Throws UserError when one cannot be read, Interrupted when the user asks to stop.
Fingerprint TakeFingerprint(const std::filesystem::path& path, const Reporter& reporter);

/// What `path` looks like now, its content copied from `known` when its state shows that nothing changed,
/// else read. Two fingerprints with equal `content` are of the same content.
Fingerprint RefreshFingerprint(const std::filesystem::path& path, const Fingerprint& known,
                               const Reporter& reporter);

}  // namespace s2gs
