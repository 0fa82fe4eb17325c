#include "sfm_split/silhouettes/silhouette.h"

#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "sfm_split/base/error.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/split/change_maps.h"
#include "sfm_split/split/station_pictures.h"

namespace s2gs {
namespace {

constexpr int kGapPx = 7;    // of an outline that is closed: where both sides are alike
constexpr int kSpeckPx = 3;  // side of what is no change of its own
constexpr int kSeamPx = 7;   // a shadow's border, which a patch of 5 x 5 pixels lies across, is thinner
constexpr double kOftenChanged = 0.25;  // of the photos: what passes by shows in fewer
constexpr float kRimFromPx = 0.5F;      // nearer is inside
constexpr float kRimToPx = 1.5F;        // one pixel wide

cv::Mat Square(int side) { return cv::Mat::ones(side, side, CV_8UC1); }

cv::Mat Disc(int side) { return cv::getStructuringElement(cv::MORPH_ELLIPSE, {side, side}); }

cv::Mat Changed(const ChangeMap& map) {
  const cv::Mat deviation(map.height, map.width, CV_8UC1, const_cast<uint8_t*>(map.deviation.data()));
  cv::Mat changed = deviation > ChangeMap::kChangedSigmas * ChangeMap::kLevelsPerSigma;
  cv::morphologyEx(changed, changed, cv::MORPH_OPEN, Square(kSpeckPx));
  return changed;
}

// Closed, and without holes; 255 where it is.
cv::Mat Filled(const cv::Mat& changed) {
  cv::Mat padded;
  cv::copyMakeBorder(changed, padded, kGapPx, kGapPx, kGapPx, kGapPx, cv::BORDER_CONSTANT, cv::Scalar(0));
  cv::morphologyEx(padded, padded, cv::MORPH_CLOSE, Disc(kGapPx));
  cv::floodFill(padded, cv::Point(0, 0), cv::Scalar(128));
  const cv::Mat filled = padded != 128;
  return filled(cv::Rect(kGapPx, kGapPx, changed.cols, changed.rows)).clone();
}

// The largest part of what changes in many photos.
cv::Mat OftenChanged(const std::vector<cv::Mat>& changed) {
  cv::Mat count = cv::Mat::zeros(changed.front().size(), CV_32F);
  for (const cv::Mat& photo : changed) cv::add(count, 1.0, count, photo);
  cv::Mat often = count >= kOftenChanged * static_cast<double>(changed.size());
  cv::morphologyEx(often, often, cv::MORPH_CLOSE, Disc(kGapPx));
  cv::Mat labels;
  cv::Mat stats;
  cv::Mat centres;
  const int num = cv::connectedComponentsWithStats(often, labels, stats, centres);
  int largest = 0;
  for (int k = 1; k < num; ++k) {
    if (largest == 0 || stats.at<int>(k, cv::CC_STAT_AREA) > stats.at<int>(largest, cv::CC_STAT_AREA))
      largest = k;
  }
  if (largest == 0) return cv::Mat::zeros(often.size(), CV_8UC1);
  return labels == largest;
}

// The parts of a photo's changes that touch where changes are frequent.
cv::Mat PartsThatTouch(const cv::Mat& filled, const cv::Mat& often) {
  cv::Mat labels;
  const int num = cv::connectedComponents(filled, labels);
  std::vector<char> touches(static_cast<size_t>(num), 0);
  for (int y = 0; y < labels.rows; ++y) {
    for (int x = 0; x < labels.cols; ++x) {
      const int label = labels.at<int>(y, x);
      if (label > 0 && often.at<uint8_t>(y, x) != 0) touches[static_cast<size_t>(label)] = 1;
    }
  }
  cv::Mat parts(filled.size(), CV_8UC1);
  for (int y = 0; y < labels.rows; ++y) {
    for (int x = 0; x < labels.cols; ++x)
      parts.at<uint8_t>(y, x) = touches[static_cast<size_t>(labels.at<int>(y, x))] != 0 ? 255 : 0;
  }
  return parts;
}

Silhouette Outline(const ChangeMap& map, const cv::Mat& changed, const cv::Mat& part,
                   const Eigen::Vector2d& photo_px, int max_rim) {
  Silhouette result;
  result.width = map.width;
  result.height = map.height;
  result.photo_px = photo_px;
  if (cv::countNonZero(part) == 0) return result;
  cv::Mat inside;
  cv::Mat outside;
  cv::distanceTransform(part, inside, cv::DIST_L2, cv::DIST_MASK_PRECISE);
  cv::distanceTransform(~part, outside, cv::DIST_L2, cv::DIST_MASK_PRECISE);
  // Both count from the centres of pixels, half a pixel on either side of the outline.
  cv::Mat distance = inside - outside;
  for (int k = 0; k < static_cast<int>(distance.total()); ++k) {
    float& d = distance.ptr<float>()[k];
    d = std::clamp(d - (d > 0 ? 0.5F : -0.5F), -Silhouette::kReachPx, Silhouette::kReachPx);
  }
  result.inside.assign(distance.begin<float>(), distance.end<float>());
  const cv::Mat is_shade(map.height, map.width, CV_8UC1, const_cast<uint8_t*>(map.is_shade.data()));
  cv::Mat hides = changed & (is_shade == 0);
  cv::morphologyEx(hides, hides, cv::MORPH_OPEN, Square(kSeamPx));
  cv::dilate(hides, hides, Square(kSpeckPx));
  std::vector<Eigen::Vector2d> rim;
  for (int y = 0; y < distance.rows; ++y) {
    for (int x = 0; x < distance.cols; ++x) {
      const float d = distance.at<float>(y, x);
      if (d >= kRimFromPx && d < kRimToPx && hides.at<uint8_t>(y, x) != 0)
        rim.push_back(photo_px.cwiseProduct(Eigen::Vector2d(x + 0.5, y + 0.5)));
    }
  }
  const size_t stride = std::max<size_t>(1, rim.size() / static_cast<size_t>(std::max(1, max_rim)));
  for (size_t k = stride / 2; k < rim.size(); k += stride) result.rim.push_back(rim[k]);
  return result;
}

}  // namespace

float Silhouette::Outside(const Eigen::Vector2d& xy) const {
  const double x = xy.x() / photo_px.x() - 0.5;
  const double y = xy.y() / photo_px.y() - 0.5;
  if (!(x >= 0 && y >= 0 && x < width - 1 && y < height - 1)) return 0;
  const auto column = static_cast<int>(x);
  const auto row = static_cast<int>(y);
  const auto u = static_cast<float>(x - column);
  const auto v = static_cast<float>(y - row);
  const float* at = inside.data() + static_cast<size_t>(row) * width + column;
  const float above = at[0] + u * (at[1] - at[0]);
  const float below = at[width] + u * (at[width + 1] - at[width]);
  return std::max(0.0F, -(above + v * (below - above)));
}

GreyPicture PictureOf(const GreyPhoto& photo) {
  GreyPicture picture = PictureFor({photo.width, photo.height});
  const cv::Mat bytes(photo.height, photo.width, CV_8UC1, const_cast<uint8_t*>(photo.grey.data()));
  cv::Mat reduced = bytes;
  if (picture.width < photo.width || picture.height < photo.height)
    cv::resize(bytes, reduced, {picture.width, picture.height}, 0, 0, cv::INTER_AREA);
  picture.grey.assign(reduced.begin<uint8_t>(), reduced.end<uint8_t>());
  return picture;
}

std::vector<Silhouette> FindSilhouettes(const std::vector<GreyPicture>& pictures, int max_rim) {
  S2GS_INVARIANT(!pictures.empty() && max_rim > 0);
  PictureStations one;
  one.station_of_image.assign(pictures.size(), 0);
  one.photo_from_first.assign(pictures.size(), Eigen::Matrix3d::Identity());
  const SceneChanges changes = FindChanges(pictures, one, ChangeDetail::kSilhouettes);
  std::vector<Silhouette> result(pictures.size());
  if (changes.photos.front().deviation.empty()) return result;
  std::vector<cv::Mat> changed;
  for (const ChangeMap& map : changes.photos) changed.push_back(Changed(map));
  const cv::Mat often = OftenChanged(changed);
  ParallelFor(static_cast<int64_t>(pictures.size()), 0, [&](int64_t i) {
    const auto k = static_cast<size_t>(i);
    result[k] = Outline(changes.photos[k], changed[k], PartsThatTouch(Filled(changed[k]), often),
                        pictures[k].Scale(), max_rim);
  });
  return result;
}

}  // namespace s2gs
