#include "sfm_split/matching/weak_features.h"

#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>

#include "sfm_split/base/angles.h"
#include "sfm_split/matching/descriptor_match.h"
#include "sfm_split/matching/keypoint_grid.h"
#include "sfm_split/matching/picture_noise.h"

namespace s2gs {
namespace {

constexpr int kMargin = 32;    // around the region, for the descriptors' windows [px]
constexpr int kLayers = 3;     // of an octave
constexpr double kSigmas = 4;  // of the noise of a difference of Gaussians
// Of white noise of one grey level in the differences of Gaussians of the finest layer of a doubled photo.
constexpr double kNoiseOfDifference = 0.15;
constexpr double kColmapContrast = 0.02;  // below it, COLMAP has left features out
constexpr double kEdgeThreshold = 10;     // ratio of curvatures, as Lowe 2004 and COLMAP have it
constexpr float kDoublingPx =
    0.25F;  // OpenCV enlarges pixels about their centres, its keypoints about a corner
constexpr float kSamePlacePx = 1.5F;  // a judgement: a keypoint found twice lies within a pixel or so
constexpr float kSameScale = 1.5F;    // ratio; a judgement: layers of an octave are 1.26 apart

// COLMAP's normalisation: the roots of each value's share of the sum (Arandjelovic and Zisserman 2012).
void AppendRoots(const float* descriptor, std::vector<uint8_t>* out) {
  float sum = 0;
  for (int i = 0; i < kDescriptorSize; ++i) sum += descriptor[i];
  for (int i = 0; i < kDescriptorSize; ++i) {
    const float root = sum > 0 ? std::sqrt(descriptor[i] / sum) : 0.0F;
    out->push_back(static_cast<uint8_t>(std::clamp(std::lround(512 * root), 0L, 255L)));
  }
}

}  // namespace

SiftFeatures FindWeakFeatures(const GreyRegion& photo, const Keypoints& known,
                              const std::vector<float>& known_scales, int max_features) {
  SiftFeatures features;
  const cv::Mat grey(photo.height, photo.width, CV_8UC1, const_cast<uint8_t*>(photo.grey));
  const cv::Mat wanted(photo.height, photo.width, CV_8UC1, const_cast<uint8_t*>(photo.is_wanted));
  cv::Rect box = cv::boundingRect(wanted);
  if (box.empty()) return features;
  box = cv::Rect(box.x - kMargin, box.y - kMargin, box.width + 2 * kMargin, box.height + 2 * kMargin) &
        cv::Rect(0, 0, photo.width, photo.height);
  const double contrast =
      std::min(kColmapContrast, kLayers * kSigmas * kNoiseOfDifference * PictureNoise(grey) / 255);
  const cv::Ptr<cv::SIFT> sift = cv::SIFT::create(0, kLayers, contrast, kEdgeThreshold);
  std::vector<cv::KeyPoint> found;
  sift->detect(grey(box), found, wanted(box));

  const KeypointGrid grid(known, 4.0F);
  std::vector<cv::KeyPoint> fresh;
  for (const cv::KeyPoint& keypoint : found) {
    const float x = keypoint.pt.x + static_cast<float>(box.x) + 0.5F - kDoublingPx;
    const float y = keypoint.pt.y + static_cast<float>(box.y) + 0.5F - kDoublingPx;
    bool is_known = false;
    grid.ForEachWithin({x, y}, kSamePlacePx, [&](uint32_t other, float /*squared*/) {
      if (known_scales.empty()) {
        is_known = true;
        return;
      }
      const float ratio = 0.5F * keypoint.size / std::max(known_scales[other], 1e-3F);
      is_known = is_known || (ratio < kSameScale && ratio * kSameScale > 1);
    });
    if (!is_known) fresh.push_back(keypoint);
  }
  std::stable_sort(fresh.begin(), fresh.end(),
                   [](const cv::KeyPoint& a, const cv::KeyPoint& b) { return a.response > b.response; });
  if (static_cast<int>(fresh.size()) > max_features) fresh.resize(max_features);
  if (fresh.empty()) return features;
  cv::Mat descriptors;
  sift->compute(grey(box), fresh, descriptors);
  for (int k = 0; k < static_cast<int>(fresh.size()); ++k) {
    features.keypoints.emplace_back(fresh[k].pt.x + static_cast<float>(box.x) + 0.5F - kDoublingPx,
                                    fresh[k].pt.y + static_cast<float>(box.y) + 0.5F - kDoublingPx);
    features.scales.push_back(0.5F * fresh[k].size);
    features.orientations.push_back(fresh[k].angle * static_cast<float>(kPi) / 180);
    AppendRoots(descriptors.ptr<float>(k), &features.descriptors);
  }
  return features;
}

}  // namespace s2gs
