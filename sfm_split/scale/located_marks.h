#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "sfm_split/scale/markers.h"
#include "sfm_split/scale/scale_bars.h"
#include "sfm_split/scene/io/colmap_model.h"

namespace s2gs {

/// A place that photos show: a marker's corner, or a point that somebody marked.
struct LocatedMark {
  Eigen::Vector3d x = Eigen::Vector3d::Zero();  ///< in the model's frame and unit.
  int num_photos = 0;                           ///< that agree on it.
  double error_px = 0;                          ///< mean reprojection error in these.
};

/// Where marks are seen: by the photo's name, the mark's number and its place in the photo [px].
using MarkSightings = std::map<std::string, std::map<int, Eigen::Vector2d>>;

/// Triangulates marks with the poses of a model, robustly: sightings that disagree with most of a mark's
/// others do not count. Marks that fewer than two photos agree on are left out.
std::map<int, LocatedMark> LocateMarks(const ColmapModel& model, const MarkSightings& sightings);

/// A marker in the model.
struct LocatedMarker {
  int id = 0;
  std::array<LocatedMark, 4> corners;
  double side = 0;  ///< mean of the four sides, in the model's unit.
  double bend = 0;  ///< largest difference of a side or a diagonal from a square's, as a share of the side.
  int num_photos = 0;  ///< of the corner that fewest see.

  Eigen::Vector3d Center() const { return (corners[0].x + corners[1].x + corners[2].x + corners[3].x) / 4; }
};

/// Markers of which all four corners were located, by number. \param sightings  by the photo's name.
std::vector<LocatedMarker> LocateMarkers(const ColmapModel& model,
                                         const std::map<std::string, std::vector<MarkerSighting>>& sightings);

/// One bar for each marker: its mean side.
std::vector<ScaleBar> BarsOfMarkers(const std::vector<LocatedMarker>& markers, double side_m);

}  // namespace s2gs
