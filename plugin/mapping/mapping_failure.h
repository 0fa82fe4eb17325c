#pragma once

#include <filesystem>

#include "sfm_split/base/error.h"
#include "sfm_split/scene/scan_features.h"

namespace s2gs {

/// Why SfM found no model of these photos, by their features and matches, and what to photograph differently:
/// photos without texture, photos that have nothing in common, photos between which nothing moved, or none of
/// these. \param path  the database, for the message.
UserError ExplainNoModel(const std::filesystem::path& path, const ScanFeatures& features);

}  // namespace s2gs
