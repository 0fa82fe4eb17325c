#pragma once

#include <filesystem>
#include <vector>

#include "sfm_split/base/reporter.h"
#include "sfm_split/scene/io/colmap_model.h"

namespace s2gs {

/// Gives points the mean colour of their keypoints in the photos, each of which is read once for all models.
/// Photos that cannot be read count for nothing; the reporter warns once.
void ColorPoints(const std::filesystem::path& image_folder, const std::vector<ColmapModel*>& models,
                 Reporter& reporter);

}  // namespace s2gs
