#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "sfm_split/base/reporter.h"
#include "sfm_split/photo_tracks/patch_alignment.h"
#include "sfm_split/scene/features.h"
#include "sfm_split/scene/io/colmap_model.h"

namespace s2gs {

/// A whole photo in shades of grey.
struct GreyPhoto {
  int width = 0;
  int height = 0;
  std::vector<uint8_t> grey;  ///< height * width, from top to bottom.
};

/// By name; what it throws is passed on. Called from several threads.
using ReadGreyPhoto = std::function<GreyPhoto(const std::string& name)>;

struct TrackPlacesOptions {
  PatchOptions patch;
  int min_found = 3;  ///< photos of a track that must agree.
  double max_sigma_px = 0.15;
  int num_neighbours = 12;        ///< points that a first plane is laid through.
  int max_observations = 150000;  ///< of the longest tracks.
  /// Least cosine between a patch's normal and its ray in a photo beside its track; 1: tracks stay as they
  /// are.
  double min_facing = 0.5;
  /// Of the longest tracks; more tell poses no better than their surface's own errors allow.
  int max_beside = 40000;

  OptionCheck Check() const;
};

struct TrackPlace {
  uint32_t image_id = 0;
  uint32_t point2D_idx = kNoKeypoint;  ///< none: the photo's keypoints do not see the point.
  bool is_beside = false;              ///< in a photo that is not of the track.
  PatchPlace place;
};

/// A place of the surface that photos show, whether keypoints see it or not.
struct SurfacePoint {
  SurfacePatch patch;
  std::vector<uint32_t> image_ids;  ///< that show it; the first stands for the others.
};

/// The places of a point in the photos of its track and in others that it faces, by patches of the photos.
struct AlignedTrack {
  uint64_t point3D_id = 0;
  SurfacePatch patch;
  std::vector<TrackPlace> places;  ///< those that were found.
};

/// Aligns the tracks of a model whose poses are good. Tracks of which too few photos agree are left out.
/// Those that stay are looked for in every photo that their patch faces: descriptors follow a point over some
/// 30 degrees of a turn, patches that are projected by its pose as long as it is seen.
std::vector<AlignedTrack> AlignTracks(const ColmapModel& model, const ReadGreyPhoto& read,
                                      const TrackPlacesOptions& options, Reporter& reporter);

/// The same of points that are none of the model's. Their ids follow those of the model's points.
std::vector<AlignedTrack> AlignPoints(const ColmapModel& model, const std::vector<SurfacePoint>& points,
                                      const ReadGreyPhoto& read, const TrackPlacesOptions& options,
                                      Reporter& reporter);

}  // namespace s2gs
