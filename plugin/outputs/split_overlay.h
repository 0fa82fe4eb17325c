#pragma once

#include <filesystem>

#include "plugin/outputs/split_files.h"
#include "sfm_split/base/reporter.h"
#include "sfm_split/split/motion_split.h"

namespace s2gs {

/// Draws keypoints over photos, coloured by label: rotating orange, static blue, unknown small and grey, and
/// writes them as folder/NAME.jpg. Photos that cannot be read are warned about and left out.
/// \param max_photos  so many, spread evenly over all.
/// \return the number of pictures written.
int WriteSplitOverlays(const std::filesystem::path& folder, const std::filesystem::path& image_path,
                       const SplitFeatures& features, const MotionSplit& split, int max_photos,
                       Reporter& reporter);

}  // namespace s2gs
