#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <vector>

#include "sfm_split/descriptor_match.h"
#include "sfm_split/error.h"
#include "sfm_split/reporter.h"
#include "sfm_split/stations.h"
#include "sfm_split/two_view_motion.h"

namespace s2gs {

enum class KeypointLabel : uint8_t { kUnknown = 0, kStatic = 1, kRotating = 2 };

struct MotionSplitOptions {
  /// Images of its own station that must show a keypoint unmoved before it counts as background (fewer when
  /// the station has fewer partners to offer).
  int min_static_support = 3;
  /// Matches inside a station that move by no more are not evidence of the table's turn [px].
  double min_moved_px = 3;
  /// Largest distance, in steps of the table, of object pairs inside a station.
  int max_object_steps = 8;
  /// Images on each side of the best partner in another station that are matched as well.
  int station_window = 2;
  /// Images of a station that look for their partner among all images of another station.
  int station_probes = 4;

  OptionCheck Check() const;
};

/// One image's features. Images are given in capture order (usually the order of names).
struct SplitImage {
  std::string name;
  Eigen::Vector2i size = Eigen::Vector2i::Zero();  ///< width, height [px].
  Keypoints keypoints;                             ///< [px]
  std::vector<uint8_t> descriptors;                ///< keypoints.size() x 128, row-major.
};

/// Matches of one pair that follow one rigid motion.
struct VerifiedPair {
  int image1 = 0;
  int image2 = 0;
  FeatureMatches matches;
  Eigen::Matrix3d F = Eigen::Matrix3d::Zero();  ///< x2ᵀ F x1 = 0 in pixels.
  Eigen::Matrix3d H = Eigen::Matrix3d::Zero();  ///< zero unless is_planar.
  bool is_planar = false;
};

/// The photos taken apart into what stands still and what turns.
struct MotionSplit {
  Stations stations;
  std::vector<int> representative;                 ///< per station: the image that stands for its background.
  std::vector<std::vector<KeypointLabel>> labels;  ///< per image, per keypoint.
  std::vector<VerifiedPair> object_pairs;
  std::vector<VerifiedPair> static_pairs;  ///< between representatives of different stations.
  int64_t num_pairs_matched = 0;
};

/// Splits photos taken from one or more stations at which a table turned in front of a fixed background.
///
/// Inside a station a keypoint of the background stays at its pixel while the table turns, so background
/// keypoints name themselves; the others are matched among each other as if the background had been masked,
/// and what follows one epipolar geometry is the rotating part. Across stations each label is matched with
/// its own kind. No pair is matched that these rounds do not ask for: their number grows linearly with the
/// images. Throws Interrupted when the reporter asks to stop.
MotionSplit SplitMotion(const std::vector<SplitImage>& images, const StationOptions& station_options,
                        const DescriptorMatchOptions& match_options,
                        const TwoViewMotionOptions& motion_options, const MotionSplitOptions& options,
                        Reporter* reporter);

}  // namespace s2gs
