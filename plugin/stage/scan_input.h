#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "plugin/stage/split_labels.h"
#include "plugin/stage/workspace.h"
#include "sfm_split/scene/scan_features.h"

namespace s2gs {

/// split/labels.json and the two databases.
struct ScanInput {
  CaptureCase capture_case = CaptureCase::kTurntable;
  std::string reason;  ///< of the case, in the split's words; may be empty.
  ScanFeatures features;
};

/// Labels are those of the split, whatever WriteScanLabels wrote since. Throws UserError when the split has
/// not run or its files contradict each other.
ScanInput ReadScanInput(const Workspace& workspace);

/// Replaces the keypoints' labels in split/labels.json, keeps those of the split beside them, and leaves the
/// rest as it is.
void WriteScanLabels(const Workspace& workspace, const std::vector<ScanImage>& images,
                     const std::vector<std::vector<KeypointLabel>>& labels);

}  // namespace s2gs
