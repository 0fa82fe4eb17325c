#pragma once

#include <memory>
#include <vector>

#include "sfm_split/base/error.h"
#include "sfm_split/base/reporter.h"
#include "sfm_split/photo_tracks/photo_adjustment.h"
#include "sfm_split/photo_tracks/track_places.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

struct SweepOptions {
  /// Photos are shrunk by a whole number to about this, so that a patch holds as much of the thing in any
  /// [px, longer side].
  int side_px = 1280;
  int radius_px = 7;         ///< of a patch, in the shrunk photo.
  int spacing_px = 10;       ///< between patches of a photo: they share less than half of their pixels.
  int max_seeds = 200;       ///< of a photo, the best textured.
  double max_turn_deg = 40;  ///< between a photo and a neighbour: patches look too different beyond.
  /// Of patches: half of what varies is what both show. A patch of radius 7 has some forty values of its own
  /// after smoothing; in that many noise correlates so well once in 1e7, and some hundred depths are tried.
  double min_correlation = 0.7;

  OptionCheck Check() const;
};

/// Points of an object's surface that the photos of a station agree on, found without keypoints: along the
/// ray of a place that has texture, the depth at which both neighbours of the photo show the same patch. They
/// need poses that are right to some pixels. Only where the station's own pictures tell the thing's outline
/// (FindSilhouettes), and only what moves: patches that lie across the outline slide over the surface.
class SurfaceSweep {
 public:
  /// Reads the photos. Throws Interrupted when the reporter asks to stop, and what `read` throws.
  SurfaceSweep(const AlignedScene& aligned, const ReadGreyPhoto& read, const SweepOptions& options,
               Reporter& reporter);
  ~SurfaceSweep();

  int NumPoints() const;

  /// Where photos show them (AlignPoints); places and their deviations are in the photos' own pixels, ids
  /// follow those of the model's points.
  std::vector<AlignedTrack> Tracks(PhotosLookedIn where, Reporter& reporter) const;

 private:
  struct Data;
  std::unique_ptr<Data> data_;
};

}  // namespace s2gs
