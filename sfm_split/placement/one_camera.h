#pragma once

#include <optional>
#include <string>
#include <vector>

#include "sfm_split/placement/place_scan.h"

namespace s2gs {

/// A scan as one camera before a table took it.
struct OneCameraScan {
  ScanFeatures features;  ///< all photos at one station.
  ScanPlacement placement;
  std::string finding;  ///< why, for the report.
};

/// Photos that the split took for one body, since too little of what stands still shows to tell that the
/// camera did. As the object sees it, such a camera goes about it on a circle and always looks at the axis
/// alike. Where SfM's cameras of nearly all photos do, within what a table's plate may wobble by, and raw
/// matches in half of the photos stay at their pixels, everything is placed as at one station (PlaceScan),
/// and taken where no photo that SfM placed is lost. A camera in the hand strays farther, and before a rig's
/// nothing stays in place; nothing is returned then.
///
/// \param features  with raw_pairs.
/// \param objects  SfM's models, the largest first. Other parameters as PlaceScan's.
std::optional<OneCameraScan> PlaceBeforeOneCamera(const ScanFeatures& features,
                                                  const std::vector<ColmapModel>& objects,
                                                  const ReadDescriptors& read_descriptors,
                                                  const ReadGreyPhoto& read_photo,
                                                  const PlacementOptions& options, Reporter& reporter);

}  // namespace s2gs
