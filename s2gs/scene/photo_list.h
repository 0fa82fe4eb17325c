#pragma once

#include <filesystem>
#include <set>
#include <string>
#include <vector>

#include "s2gs/scene/training_scene.h"

namespace s2gs {

/// The names in a list of photos, one a line; white space behind a name does not count, nor do empty lines.
/// Throws UserError for names that are no photo's. \param option  that names the list, as "--test_list".
std::set<std::string> ReadPhotoList(const std::filesystem::path& path, const std::vector<ScenePhoto>& photos,
                                    const std::string& option);

/// The photos that are kept from training. Throws UserError as ReadPhotoList() does.
std::set<std::string> HeldOutNames(const TrainingSceneOptions& options,
                                   const std::vector<ScenePhoto>& photos);

}  // namespace s2gs
