#pragma once

#include "sfm_split/scene/io/colmap_model.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

/// Gives an aligned scene of circular motion, which has neither, the background's model, brought to where the
/// scene has the stations' cameras: the similarity of least squares. Photos of the model that the scene lacks
/// are left out of it; its images get the scene's poses, to which its points are as near as the two agree.
/// \return  whether the scene can go on: false where the cameras of the model contradict the scene's, and
/// nothing is changed. A model of fewer than two of the scene's stations says nothing and is not taken.
bool PutBackgroundBeside(const ColmapModel& background, AlignedScene* aligned);

}  // namespace s2gs
