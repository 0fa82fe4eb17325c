#pragma once

#include <cstdint>
#include <vector>

#include "sfm_split/split/motion_split.h"
#include "sfm_split/split/split_matching.h"

namespace s2gs {

/// The background as all photos of one station show it together: keypoints that stay at their pixel from
/// photo to photo are one feature, at the mean of their places and with the mean of their descriptors. What
/// any photo shows is there, whichever photo carries it, and with less noise than in any one.
struct StationBackground {
  int carrier = -1;                  ///< the photo in whose frame the features lie.
  Keypoints keypoints;               ///< [px]
  std::vector<float> scales;         ///< [px]
  std::vector<uint8_t> descriptors;  ///< keypoints.size() x 128.
  /// Per photo of the station, in its order, and per keypoint: the feature that it shows, or kNoFeature.
  std::vector<std::vector<uint32_t>> feature_of_keypoint;

  static constexpr uint32_t kNoFeature = UINT32_MAX;  ///< of feature_of_keypoint
};

/// Merges the static keypoints of a station's photos. Features that fewer than `min_photos` show are left
/// out. \param labels          per image and keypoint; static ones are merged. \param max_unmoved_px  largest
/// distance of a keypoint from its feature's place [px].
StationBackground MergeBackground(const std::vector<SplitImage>& images, const Stations& stations,
                                  const std::vector<std::vector<KeypointLabel>>& labels, int station,
                                  int carrier, int min_photos, double max_unmoved_px);

/// The matches of two stations' backgrounds: by features, image1 and image2 are the carriers.
struct BackgroundMatches {
  ImagePairMatches raw;   ///< mutual nearest neighbours, of which the most may be wrong.
  VerifiedPair verified;  ///< those that follow the motion between the stations; none when it was not found.
};

/// Matches pairs of stations: strictly first, for the motion between the two; then every mutual nearest
/// neighbour that follows it counts, however close the second nearest, and fits it again. A motion that
/// chance explains is none. \param pairs  of stations, numbers in `backgrounds`. Throws Interrupted.
std::vector<BackgroundMatches> MatchBackgrounds(const std::vector<StationBackground>& backgrounds,
                                                const std::vector<ImagePair>& pairs,
                                                const GivenMatches& given, const Stations& stations,
                                                SplitMatching* matching);

}  // namespace s2gs
