#pragma once

#include <optional>
#include <string>
#include <vector>

#include "sfm_split/placement/place_scan.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

/// A station for each image of the features, where poses show that photos which pictures left in stations of
/// a few were taken from one place: as the object sees it, a camera that rests goes about the table's axis on
/// a circle, and always looks at it alike. Within what a plate may wobble by; photos of six or more steps, or
/// those of a station that has as many. Nothing where no station changes.
std::optional<std::vector<int>> StationsByPoses(const ScanFeatures& features, const TurntableScene& scene);

/// A station for each image of the features, where pictures left photos in stations of a few that follow one
/// another: of six or more, one station, and of a few that one larger station is beside, amid its photos or
/// at the scan's ends, that one. A tripod before a plain wall rests for many photos though no picture tells,
/// but nothing says that it did: to be proven. Nothing where no station changes.
std::optional<std::vector<int>> StationsByOrder(const ScanFeatures& features);

/// A scan whose stations are joined by its poses, or by the order of its photos.
struct JoinedScan {
  ScanFeatures features;
  ScanPlacement placement;
  std::string finding;  ///< why, for the report.
};

/// Places a scan anew whose poses join stations (StationsByPoses): a plain wall hardly shows that a tripod
/// rests, and photos that are stations by themselves say nothing of the table's angles. One that is not good
/// so, by the order of its photos (StationsByOrder). Nothing where no stations are joined, or the verdict is
/// worse with them; by order, where it is no better and no more photos have a place. \param placed  what
/// PlaceScan came to with these features and no background; gets its evidence where it has none and is asked
/// for it. Other parameters as PlaceScan's.
std::optional<JoinedScan> PlaceWithStationsJoined(const ScanFeatures& features, ScanPlacement* placed,
                                                  const std::vector<ColmapModel>& objects,
                                                  const ReadDescriptors& read_descriptors,
                                                  const ReadGreyPhoto& read_photo,
                                                  const PlacementOptions& options, Reporter& reporter);

}  // namespace s2gs
