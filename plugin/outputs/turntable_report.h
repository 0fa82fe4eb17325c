#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <ostream>
#include <string>
#include <vector>

#include "sfm_split/photo_tracks/photo_adjustment.h"
#include "sfm_split/relocalise/guided_registration.h"
#include "sfm_split/relocalise/scan_refinement.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

nlohmann::json ToJson(const std::vector<GuidedPhoto>& photos);
nlohmann::json ToJson(const PhotoAdjustment& photos);

/// A body's points, observations and reprojection errors [px], by the errors that its points carry:
/// `mean_reprojection_error_px` is over points, as COLMAP's model_analyzer gives it, and
/// `mean_observation_error_px` over observations, so that a point counts as often as it is seen.
nlohmann::json DescribePoints(const ColmapModel& model);

/// What an adjusted scene says of itself, for split/turntable_mapper.json: images and why some are missing or
/// came back, points and reprojection errors of both bodies, standard deviations, observability, the joint
/// model and the tests that chose it.
nlohmann::json DescribeScene(const AlignedScene& aligned, const RefineReport& refined);

/// The summary table of split/turntable_mapper.json. Throws UserError, and prints nothing, when the file is
/// missing or damaged.
void PrintTurntableSummary(const std::filesystem::path& path, std::ostream& out);

}  // namespace s2gs
