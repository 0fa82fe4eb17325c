#pragma once

#include <functional>
#include <optional>

#include "s2gs/backend/backend.h"
#include "s2gs/image/image_file.h"
#include "s2gs/rotating_mask.h"
#include "s2gs/table_circle.h"
#include "s2gs/table_rim.h"
#include "s2gs/training_scene.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

using LoadPhoto = std::function<Image8(const ScenePhoto&)>;

/// The table's top from what stays the same in most photos of each station (table_circle.h), about where the
/// rotating part begins. Nothing where no station has photos enough, nothing turns, or no rim is found.
/// Throws what `load` throws, and Interrupted. \param load  a photo without distortion, of its view's size.
std::optional<TableCircle> FindTableInPhotos(const TrainingScene& scene, const LoadPhoto& load,
                                             Reporter& reporter);

/// The same as masks need it. \param shape, backend  of the model, which is left as it was: what it takes to
/// stand still of the top as photos show it.
TableRim RimOfCircle(const TrainingScene& scene, const TableCircle& circle,
                     const std::optional<RotatingShape>& shape, Backend* backend);

}  // namespace s2gs
