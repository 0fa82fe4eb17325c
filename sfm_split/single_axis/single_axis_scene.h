#pragma once

#include "sfm_split/base/reporter.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/single_axis/single_axis.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

/// An aligned scene of the images that a single-axis solution found, without points: from the background's
/// cameras (one pose a station) and the matches on the rotating part. Without a background there must be one
/// station, whose camera is then the world's frame. Empty when no turntable was found.
/// \param background  null or empty: none.
AlignedScene SceneFromSingleAxis(const ScanFeatures& features, const ColmapModel* background,
                                 const SingleAxisOptions& options, Reporter& reporter,
                                 SingleAxisSolution* solution);

}  // namespace s2gs
