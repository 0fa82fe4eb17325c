#pragma once

#include <filesystem>
#include <map>
#include <string>

#include "plugin/stage/workspace.h"

namespace s2gs {

// The figures of a run, by name. What cannot be read or compared is missing.

/// Those that `scan_evaluator --json_path` wrote, as NAME.STATISTIC.
std::map<std::string, double> EvaluatedFigures(const std::filesystem::path& json_path);

/// The last measurement of held-out photos in the training's log: held_out_rmse (10^(-PSNR / 20)), psnr_db,
/// ssim, mask_iou and the like, and the number of Gaussians.
std::map<std::string, double> TrainingFigures(const Workspace& workspace);

/// Poses of sparse/0 against another run's after a similarity fit: own_rotation_deg (median), own_centre_pct
/// (median, of the cameras' median distance from their middle) and own_images (share of its photos).
std::map<std::string, double> PosesAgainst(const Workspace& workspace, const Workspace& reference);

/// What a run says of itself: held_back_px of the poses (RMS of the matches that the adjustment did not see),
/// and photo_disagreement of the mesh (1 - correlation of the photos on it).
std::map<std::string, double> OwnFigures(const Workspace& workspace);

/// The mesh against another run's, in the poses' frame: own_chamfer_pct, of the diagonal of its bounding box.
std::map<std::string, double> MeshAgainst(const Workspace& workspace, const Workspace& reference);

}  // namespace s2gs
