#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "sfm_split/scene/io/colmap_database.h"

namespace s2gs {

constexpr int kFixtureWidth = 16;
constexpr int kFixtureHeight = 12;

/// A database of one camera and images with ids 1, 2, ... in the order given, each with keypoints at (1, 2)
/// and (3, 4); every entry of keypoint k's descriptor in image i is i + k. Replaces the file.
/// \param more  changes the database further; may be empty.
void WriteSplitFixture(const std::filesystem::path& path, const std::vector<std::string>& names,
                       const std::function<void(ColmapDatabase&)>& more = nullptr);

}  // namespace s2gs
