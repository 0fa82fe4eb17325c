#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <vector>

namespace s2gs {

/// Keypoint positions of one image [px].
using Keypoints = std::vector<Eigen::Vector2f>;

/// The row of a keypoint that there is not.
constexpr uint32_t kNoKeypoint = std::numeric_limits<uint32_t>::max();

/// A pair of keypoints, by their rows in the keypoints of the first and of the second image.
struct FeatureMatch {
  uint32_t point2D_idx1 = 0;
  uint32_t point2D_idx2 = 0;
  bool operator==(const FeatureMatch& other) const {
    return point2D_idx1 == other.point2D_idx1 && point2D_idx2 == other.point2D_idx2;
  }
};
using FeatureMatches = std::vector<FeatureMatch>;

/// One image pair's feature matches: keypoint indices into image1 and image2. Images are numbered from 0 in
/// the order that the caller chose.
struct ImagePairMatches {
  int image1 = 0;
  int image2 = 0;
  FeatureMatches matches;
};

/// The body that a keypoint was found to lie on.
enum class KeypointLabel : uint8_t { kUnknown = 0, kStatic = 1, kRotating = 2 };

/// What kind of capture the photos turned out to be.
enum class CaptureCase {
  kTurntable,      ///< a rotating part in front of a background that is seen from several camera positions.
  kSingleStation,  ///< the camera never moved: only the rotating part can be reconstructed.
  kOneBody,        ///< everything that can be matched moves as one: no split.
};
/// "turntable", "single_station", "one_body".
const char* CaptureCaseName(CaptureCase capture_case);

}  // namespace s2gs
