#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "sfm_split/base/error.h"
#include "sfm_split/base/reporter.h"
#include "sfm_split/matching/descriptor_match.h"
#include "sfm_split/matching/pair_plan.h"
#include "sfm_split/split/change_maps.h"
#include "sfm_split/split/station_pictures.h"
#include "sfm_split/split/stations.h"
#include "sfm_split/split/two_view_motion.h"

namespace s2gs {

struct MotionSplitOptions {
  /// Images of its own station that must show a keypoint unmoved before it counts as background (fewer when
  /// the station has fewer partners to offer).
  int min_static_support = 3;
  /// Matches inside a station that move by no more are not evidence of the table's turn [px].
  double min_moved_px = 3;
  /// Pairs inside a station are all matched up to this many steps of the table apart, then ever more
  /// sparsely.
  int max_object_steps = 6;
  /// Best partners of an image in every other station that it is matched with, with their neighbours.
  int station_partners = 2;
  /// Largest number of other stations that the images of a station are matched with.
  int max_nearby_stations = 4;
  /// Verified matches that make a keypoint rotating.
  int min_rotating_matches = 2;
  /// Photos of one body are all matched with one another up to this number of pairs; beyond it neighbours and
  /// the most similar ones are.
  int max_exhaustive_pairs = 2000;

  OptionCheck Check() const;
};

/// One image's features. Images are given in capture order (usually the order of names).
struct SplitImage {
  std::string name;
  Eigen::Vector2i size = Eigen::Vector2i::Zero();  ///< width, height [px].
  Keypoints keypoints;                             ///< [px]
  std::vector<float> scales;                       ///< of the keypoints [px]; empty: unknown.
  std::vector<uint8_t> descriptors;                ///< keypoints.size() x 128, row-major.
  std::vector<KeypointLabel> given_labels;         ///< from a mask, one per keypoint; empty: none.
};

/// Matches of one pair that follow one rigid motion.
struct VerifiedPair {
  int image1 = 0;
  int image2 = 0;
  FeatureMatches matches;
  Eigen::Matrix3d F = Eigen::Matrix3d::Zero();  ///< x2ᵀ F x1 = 0 in pixels.
  Eigen::Matrix3d H = Eigen::Matrix3d::Zero();  ///< zero unless is_planar.
  bool is_planar = false;
  double log_false_alarms = 0;  ///< of the fit; see LogFalseAlarms().
};

/// What all photos of a station show of the background, as features of one of them: they stand after its own
/// keypoints, in the order given, and are all static.
struct StationFeatures {
  int image = 0;
  Keypoints keypoints;               ///< [px]
  std::vector<float> scales;         ///< [px]
  std::vector<uint8_t> descriptors;  ///< keypoints.size() x 128, row-major.
};

/// The photos taken apart into what stands still and what turns.
struct MotionSplit {
  CaptureCase capture_case = CaptureCase::kTurntable;
  std::string reason;                 ///< the measurement behind the case, for people.
  std::vector<std::string> warnings;  ///< what else was noticed, for people.
  /// Photos of the stations that pairs of the rotating part, with as many matches as a photo's pose needs,
  /// join to others of their station in more than one way (LargestRing), in each station's largest such set;
  /// and how many photos stations have.
  int ringed_photos = 0;
  int station_photos = 0;
  /// Things change at the stations.
  bool has_changes = false;
  /// They do, but pairs of the rotating part leave more than a tenth of the stations' photos without such a
  /// ring.
  bool lacks_features = false;
  Stations stations;
  std::vector<int> representative;                 ///< per station: the image that stands for its background.
  std::vector<StationFeatures> station_features;   ///< per station, or none at all.
  std::vector<std::vector<KeypointLabel>> labels;  ///< per image, per keypoint.
  std::vector<VerifiedPair> object_pairs;
  /// Between representatives of different stations; by their station_features, where there are any.
  std::vector<VerifiedPair> static_pairs;
  std::vector<ImagePairMatches> object_matches;  ///< raw matches behind object_pairs.
  std::vector<ImagePairMatches> static_matches;  ///< raw matches behind static_pairs, and of pairs without.
  int64_t num_pairs_matched = 0;                 ///< each pair once, however often it was matched.
};

/// Options of all steps of the split.
struct SplitSettings {
  StationOptions station;
  DescriptorMatchOptions match;
  TwoViewMotionOptions motion;
  MotionSplitOptions split;
};

/// Raw matches of pairs of images that somebody else matched, by the images' numbers, the smaller one first.
using GivenMatches = std::map<ImagePair, FeatureMatches>;

/// What the photos' pictures tell, where there are photos to look at.
struct ScanPictures {
  std::vector<GreyPicture> pictures;  ///< per image.
  PictureStations stations;
  SceneChanges changes;
};

/// Splits photos of an object that turned on a table in front of a fixed background.
///
/// With stations, camera positions at which several photos were taken, a keypoint of the background stays at
/// its pixel while the table turns, so background keypoints name themselves; the others are matched among
/// each other as if the background had been masked, and what follows one epipolar geometry is the rotating
/// part. Across stations each label is matched with its own kind. Without stations (the camera was held by
/// hand) several motions are fitted to every pair and sorted into two bodies; where that does not tell two
/// bodies apart, or nothing turns, all photos are matched as one body. Labels that are given by masks replace
/// the measured ones. The number of pairs that are matched in full grows linearly with the images.
/// \param given  when there are any, they are taken wherever pairs would be matched, and pairs that are not
/// among
///               them count as pairs without matches. Only stations and likeness are still found by matching
///               each image's largest features.
/// \param pictures  nullptr, or what tells stations apart, and whether anything changes, where features are
/// few. Throws Interrupted when the reporter asks to stop.
MotionSplit SplitMotion(const std::vector<SplitImage>& images, const SplitSettings& settings,
                        Reporter* reporter, const GivenMatches& given = {},
                        const ScanPictures* pictures = nullptr);

}  // namespace s2gs
