#pragma once

#include <optional>
#include <vector>

#include "s2gs/backend/backend.h"
#include "s2gs/core/rotating_region.h"
#include "s2gs/scene/training_scene.h"

namespace s2gs {

/// A level surface about the axis as it looks from above, in directions that are equally far apart and at
/// equal steps from the axis, the first after half a step.
struct LevelSurface {
  int num_directions = 0;
  int num_steps = 0;
  double step = 0;             ///< [scene units]
  double height = 0;           ///< of the surface, along the axis from its point.
  double tolerance = 0;        ///< of a height that is the surface's.
  std::vector<float> heights;  ///< num_directions * num_steps; not a number where nothing is seen.
  std::vector<float> colors;   ///< 3 each, [0, 1].
};

/// A circle about the axis at which a surface ends.
struct CircularEdge {
  double distance = 0;  ///< from the axis.
  /// Of the directions in which the surface is seen there: those in which it ends there.
  double share = 0;
  double false_alarms = 1;  ///< how many such circles are expected by chance.
};

/// The clearest circle at which the surface ends, by its height or its colour, in at least this share of the
/// directions in which it is seen, and in more than the edges that lie anywhere else would make by chance.
/// Nothing when there is none. \param min_share  the sides of a square about the axis are a third or, where
/// edges are soft, up to half.
std::optional<CircularEdge> FindCircularEdge(const LevelSurface& surface, double min_share);

/// The top of a table and its side.
struct TableRim {
  RotatingRegion region;
  double share = 0;         ///< CircularEdge's.
  double false_alarms = 1;  ///< CircularEdge's, of all heights that were looked at.
  /// Of the area of its top or its side, whichever has more: what the model takes to stand still.
  double static_share = 0;

  /// Whether so much of it does that the photos do not tell whether it turns.
  bool IsUndecided() const;
};

/// The table under the rotating part, whether its top turns by the photos or, being plain, looks the same as
/// if it stood still: what stands still has no reason to end in a circle about the axis. The outermost of
/// such circles: a round foot stands on the table, and not the other way round. Nothing when there is none,
/// or when one station took all photos: then the depth of what stands still is not known.
/// \param backend  with the model, which is left as it was.
std::optional<TableRim> FindTableRim(const TrainingScene& scene, Backend* backend);

}  // namespace s2gs
