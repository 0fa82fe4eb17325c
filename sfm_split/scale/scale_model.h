#pragma once

#include "sfm_split/scene/io/colmap_model.h"
#include "sfm_split/scene/io/turntable_file.h"

namespace s2gs {

/// Multiplies all lengths of a model by a positive number: positions, points, rigs and frames.
void ScaleModel(double factor, ColmapModel* model);

/// The same for a turntable, whose unit then is the metre.
void ScaleTurntableToMetres(double metres_per_unit, TurntableFile* turntable);

}  // namespace s2gs
