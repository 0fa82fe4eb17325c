#pragma once

#include <vector>

#include "sfm_split/scene/scene.h"
#include "sfm_split/silhouettes/silhouette_rays.h"

namespace s2gs {

/// How the object stands before one station against how it stands before another, by outlines.
struct SilhouetteTurn {
  /// Nowhere else do outlines agree nearly as well, by more than differs from photo to photo by chance.
  bool is_told = false;
  double turn_rad = 0;  ///< of the object before the second station's cameras, about the axis.
  /// By leaving photos out, and by how far outlines contradict each other, which may be alike in all of them
  /// (a shadow beside the thing belongs to its outline).
  double sigma_rad = 0;
  double error_px =
      0;  ///< root mean square of how far outlines contradict each other there [px of pictures].
  double elsewhere_px = 0;  ///< at the best turn elsewhere.
  double t = 0;  ///< the difference of their squares over its standard deviation, photos taken together by
                 ///< neighbours.
};

/// A ray through an outline meets the thing somewhere, and this place lies in the outlines of all other
/// photos (the visual hull). Everything but the one turn is taken as it is. \param first, second  the views
/// of a station each, neighbours in order. \param axis  of the table, in the object's frame.
SilhouetteTurn FindSilhouetteTurn(const std::vector<SilhouetteView>& first,
                                  const std::vector<SilhouetteView>& second, const TurntableAxis& axis);

}  // namespace s2gs
