#pragma once

#include <vector>

#include "mesh/fusion/tsdf_view.h"
#include "mesh/fusion/tsdf_voxel.h"

namespace s2gs {

/// The greatest depths at which a view still says something, for tiles of its map.
struct TsdfDepthTiles {
  int columns = 0;
  int rows = 0;
  std::vector<float> far;
  float far_outside_map = 0;
};

/// \param truncation  in the poses' unit. \param voxel_size  the same.
TsdfDepthTiles MakeTsdfDepthTiles(const TsdfView& view, double truncation, double voxel_size);

/// Whether any point within `radius` of a point in the camera's frame can learn something from the view.
/// May err towards true.
bool MayMatter(const TsdfViewParams& view, const TsdfDepthTiles& tiles, const float* middle, float radius);

}  // namespace s2gs
