#pragma once

#include <filesystem>
#include <ostream>

#include "sfm_split/scene/io/colmap_model.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

/// Draws an aligned turntable scene as SVG, from above (along the axis) and from the side: the axis, where
/// the cameras stand (one colour a station), where they look, both point clouds, and the object's images
/// around the table. Points far outside the cameras are left out. At most 4,000 points of each cloud are
/// drawn. \param object      in the object's frame, which is the world's at the reference image. \param
/// background  in the world's frame; may be empty.
void WriteTopView(std::ostream& stream, const TurntableScene& scene, const ColmapModel& object,
                  const ColmapModel& background);

/// The same, atomically. Throws UserError when the file cannot be written.
void WriteTopView(const std::filesystem::path& path, const TurntableScene& scene, const ColmapModel& object,
                  const ColmapModel& background);

}  // namespace s2gs
