#pragma once

#include "s2gs/backend/backend.h"
#include "s2gs/image/image_error.h"
#include "sfm_split/scene/io/colmap_maps.h"

namespace s2gs {

/// Which of a rendered view's depths.
enum class DepthKind : uint8_t { kMedian, kExpected };
const std::vector<float>& DepthsOf(const RenderedView& view, DepthKind kind);

/// Where it is opaque: half transparent is outside.
PixelMask OpaqueMask(const RenderedView& view);

/// Depths, and normals of unit length in the camera's frame, as COLMAP keeps them; 0 where the view is not
/// opaque or shows no surface.
struct ViewMaps {
  ColmapMap depth;
  ColmapMap normal;
};

/// \param view  with geometry. \param scene_size  of which its lengths are a multiple.
ViewMaps ColmapMapsOf(const RenderedView& view, DepthKind kind, double scene_size);

}  // namespace s2gs
