#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "plugin/batch/batch_list.h"
#include "plugin/batch/batch_record.h"

namespace s2gs {

/// What is shown of an object.
struct BatchEntry {
  BatchObject object;
  BatchOutcome outcome;
  std::optional<BatchRecord> record;
  /// Photo, rendering, error and mask, or a photo, as a data URI; empty where there is none.
  std::string picture;
  std::string photos;     ///< with a pose, of all: "40 of 42"; empty before that is known.
  std::string triangles;  ///< of the mesh; empty before that is known.
};

/// Looks into an object's workspace.
BatchEntry MakeBatchEntry(const BatchObject& object);

/// "12 objects: 9 done, 1 doubtful, 2 failed".
std::string CountEntries(const std::vector<BatchEntry>& entries);

/// Throws UserError when the folder has an index.html or a batch.json that WriteBatchPage() has not written.
void RequireNoOtherPage(const std::filesystem::path& folder);

/// Writes index.html, one page over all objects with a link to each one's report, and batch.json, the same
/// for programs, into a folder. Throws UserError.
/// \param title  above the page.
void WriteBatchPage(const std::filesystem::path& folder, const std::string& title,
                    const std::vector<BatchEntry>& entries);

}  // namespace s2gs
