#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "sfm_split/scene/features.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

/// What the split knows of one photo.
struct ScanImage {
  std::string name;
  uint32_t image_id = 0;
  uint32_t camera_id = 0;
  int station = 0;
  /// Where the photo shows what its station's first photo shows of the background at a pixel: shake of the
  /// tripod [px].
  Eigen::Matrix3d photo_from_first = Eigen::Matrix3d::Identity();
  Keypoints keypoints;                ///< [px]
  std::vector<KeypointLabel> labels;  ///< per keypoint.
};

/// The features and verified matches of a scan, split into what turns and what stands still.
struct ScanFeatures {
  std::map<uint32_t, Camera> cameras;
  std::map<uint32_t, bool> has_prior_focal;
  std::vector<ScanImage> images;               ///< in the order of capture, as far as it is known.
  std::vector<ImagePairMatches> object_pairs;  ///< by index into images.
  std::vector<ImagePairMatches> static_pairs;  ///< between photos that stand for their stations.
  /// Matches of the background between such photos before verification. May be empty.
  std::vector<ImagePairMatches> raw_static_pairs;
  /// Matches before verification, of both parts and wrong ones among them: once poses are known, those that
  /// agree with them count as well. May be empty.
  std::vector<ImagePairMatches> raw_pairs;
};

/// How far a match of the object moves at least between photos of one station [px]: less may be the
/// background's.
constexpr float kLeastMovePx = 3;

/// Whether the camera's focal length comes from EXIF or the user, not from a guess.
bool HasPriorFocal(const ScanFeatures& features, uint32_t camera_id);

bool IsStatic(const ScanImage& image, uint32_t keypoint);

/// How many photos each station has.
std::map<int, int> SizesOfStations(const ScanFeatures& features);

/// All matches that there are, right and wrong ones: the raw ones, else the verified ones.
const std::vector<ImagePairMatches>& AllPairs(const ScanFeatures& features);

/// Of each image, in their order; the features must outlive them.
std::vector<const Keypoints*> AllKeypoints(const ScanFeatures& features);

/// The matches of a pair that may be the object's, as far as the photos alone tell.
FeatureMatches PossibleObjectMatches(const ScanFeatures& features, const ImagePairMatches& pair);

}  // namespace s2gs
