#pragma once

#include <vector>

#include "sfm_split/scene/io/colmap_model.h"

namespace s2gs {

/// Merges models of one body that share at least three images: the smaller ones' images are moved onto the
/// first by the similarity of the shared cameras' centres. Points are not merged: images that join have none.
/// \return  how many images joined.
int JoinPartialModels(const std::vector<ColmapModel>& models, ColmapModel* first);

}  // namespace s2gs
