#pragma once

#include <Eigen/Core>
#include <vector>

#include "sfm_split/base/reporter.h"
#include "sfm_split/pictures/picture_comparison.h"
#include "sfm_split/split/stations.h"

namespace s2gs {

/// Photos grouped by camera position by what their pictures show.
struct PictureStations {
  std::vector<int> station_of_image;  ///< per photo, numbered in the order of first photos.
  /// Per photo: where it shows a background pixel of its station's first photo. [px of the photos]
  std::vector<Eigen::Matrix3d> photo_from_first;
};

/// Compares every photo with one standard of each station, so that the number of comparisons grows with
/// photos times stations. What correlates in most photos of a station does not turn: a photo in which much of
/// that lies elsewhere was taken from beside the others, however well a wall behind agrees, and is left out.
/// \param options  bounds in pixels of the photos.
/// Progress is reported as "compare pictures". Throws Interrupted when the reporter asks to stop.
PictureStations FindPictureStations(const std::vector<GreyPicture>& pictures, const StationOptions& options,
                                    Reporter& reporter);

/// The stations that pictures tell, and photos and whole stations joined to them by features that did not
/// move, strongest first. Two photos whose pictures show that the camera moved are not joined.
/// \param joins  as FindStationJoins() returns them.
Stations JoinStations(const std::vector<GreyPicture>& pictures, const PictureStations& by_picture,
                      const std::vector<StationJoin>& joins, const StationOptions& options);

}  // namespace s2gs
