#pragma once

#include <cstddef>
#include <optional>
#include <vector>

#include "s2gs/table/picture_rings.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

/// How far out a thing that turns reaches at a height: half of what is known of it there lies further out.
struct ThingRing {
  double height = 0;  ///< along the axis from its point.
  double radius = 0;
};

/// Where a table's top may be. Lengths in the poses' unit.
struct CircleSearch {
  TurntableAxis axis;
  double low = 0;  ///< along the axis from its point.
  double high = 0;
  double max_radius = 0;
  /// What stands there and turns, from its lowest ring up: it hides the far side of a rim, and a round one in
  /// all photos.
  std::vector<ThingRing> thing;
};

/// A circle about the axis at right angles to it: the rim of a table's top.
struct TableCircle {
  double height = 0;  ///< along the axis from its point.
  double radius = 0;
  /// Of the directions in which a picture shows its place, but for those without an edge where a thing stands
  /// before it: those with an edge.
  double share = 0;
  double false_alarms = 1;         ///< how many such circles are expected by chance.
  std::optional<double> side_end;  ///< where the side below it ends, along the axis from its point.
};

/// The circle at which an edge lies, to a pixel, in more directions from the axis than edges anywhere would
/// make by chance (what is an edge, the surface just within the circle tells, whatever stands further in),
/// and in half of them at least, of a circle that is one all around or where there is none but chance hardly
/// makes it; of several the outermost. What stands still has no reason to end in a circle about the axis. Its
/// side, as far as it faces a camera, ends at a lower circle, which is looked for in the same way: in all
/// pictures and in each by itself, the clearest counts. Nothing when there is none.
std::optional<TableCircle> FindTableCircle(const std::vector<StillPicture>& pictures,
                                           const CircleSearch& search);

}  // namespace s2gs
