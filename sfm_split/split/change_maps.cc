#include "sfm_split/split/change_maps.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>

#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

constexpr size_t kMinPhotos = 3;    // of which a median can leave one out
constexpr int kFitPixels = 20000;   // evenly chosen: gain and offset need no more
constexpr int kFitIterations = 10;  // of reweighting
// Standard deviations: 95 % efficient where errors are normal (Tukey's biweight).
constexpr double kTukey = 4.685;
constexpr float kLeastNoise = 1.0F;    // of 8-bit JPEGs [grey levels]
constexpr float kMisplacedPx = 0.15F;  // by shake that was measured and pixels that were interpolated
constexpr double kSaturated = 250;     // grey levels beyond it say nothing
constexpr double kDensestShare = 0.3;  // of the photos: what is hidden in more has no still picture
constexpr int kShadePx = 5;            // of a side: has texture where the still picture has
constexpr double kActivePhotos = 0.1;  // share of a station's photos, and at least two: a hand shows in one
constexpr double kCloseShare = 0.02;   // of the longest side: gaps in what changes that are filled
constexpr double kLeastAreaShare = 5e-4;  // of the picture: smaller patches are flicker

cv::Mat ToFloat(const GreyPicture& picture) {
  const cv::Mat bytes(picture.height, picture.width, CV_8UC1, const_cast<uint8_t*>(picture.grey.data()));
  cv::Mat grey;
  bytes.convertTo(grey, CV_32F);
  return grey;
}

// From the picture's pixel indices of the station's first photo to those of another.
cv::Matx33d IndexMap(const GreyPicture& picture, const Eigen::Matrix3d& photo_from_first) {
  const Eigen::Vector2d scale = picture.Scale();
  Eigen::Matrix3d to_photo = Eigen::Vector3d(scale.x(), scale.y(), 1).asDiagonal();
  to_photo.topRightCorner<2, 1>() = 0.5 * scale;
  const Eigen::Matrix3d map = to_photo.inverse() * photo_from_first * to_photo;
  cv::Matx33d result;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) result(r, c) = map(r, c);
  }
  return result;
}

// From a photo's pixels to the places in the picture of its station's first photo.
Eigen::Matrix3d FirstFromPhoto(const GreyPicture& picture, const Eigen::Matrix3d& photo_from_first) {
  const Eigen::Vector2d scale = picture.Scale();
  return Eigen::Vector3d(1 / scale.x(), 1 / scale.y(), 1).asDiagonal() * photo_from_first.inverse();
}

// Which pixel of that picture shows a photo's place [px]; nothing where it shows none.
std::optional<size_t> PixelOfFirst(const GreyPicture& picture, const Eigen::Matrix3d& first_from_photo,
                                   const Eigen::Vector2d& xy) {
  const Eigen::Vector3d at = first_from_photo * xy.homogeneous();
  const int column = static_cast<int>(std::floor(at.x() / at.z()));
  const int row = static_cast<int>(std::floor(at.y() / at.z()));
  if (column < 0 || row < 0 || column >= picture.width || row >= picture.height) return std::nullopt;
  return static_cast<size_t>(row) * picture.width + column;
}

// What the first photo's pixels show in another; NaN outside, and where light saturates.
cv::Mat AsSeenFromFirst(const GreyPicture& picture, const Eigen::Matrix3d& photo_from_first) {
  cv::Mat grey = ToFloat(picture);
  grey.setTo(cv::Scalar(std::nan("")), grey > kSaturated);
  if (photo_from_first.isApprox(Eigen::Matrix3d::Identity(), 1e-12)) return grey;
  cv::Mat moved;
  cv::warpPerspective(grey, moved, IndexMap(picture, photo_from_first), grey.size(),
                      cv::INTER_LINEAR | cv::WARP_INVERSE_MAP, cv::BORDER_CONSTANT, cv::Scalar(std::nan("")));
  return moved;
}

// Gain and offset that make `grey` most like `reference`; what changed is left out.
void MatchExposure(const cv::Mat& reference, cv::Mat* grey) {
  std::vector<float> x;
  std::vector<float> y;
  std::vector<float> ratios;
  const int stride = std::max(1, static_cast<int>(grey->total()) / kFitPixels);
  for (int k = 0; k < static_cast<int>(grey->total()); k += stride) {
    const float a = grey->ptr<float>()[k];
    const float b = reference.ptr<float>()[k];
    if (std::isnan(a) || std::isnan(b)) continue;
    x.push_back(a);
    y.push_back(b);
    if (a >= 8 && b >= 8) ratios.push_back(b / a);
  }
  if (ratios.size() < 100) return;
  double gain = UpperMedian(std::move(ratios));
  double offset = 0;
  std::vector<float> sizes(x.size());
  for (int iteration = 0; iteration < kFitIterations; ++iteration) {
    for (size_t k = 0; k < x.size(); ++k)
      sizes[k] = static_cast<float>(std::abs(gain * x[k] + offset - y[k]));
    const double limit = kTukey * std::max(1.0, kSigmaOfMad * UpperMedian(sizes));
    double s = 0;
    double sx = 0;
    double sy = 0;
    double sxx = 0;
    double sxy = 0;
    for (size_t k = 0; k < x.size(); ++k) {
      if (sizes[k] >= limit) continue;
      const double root = 1 - (sizes[k] / limit) * (sizes[k] / limit);
      const double w = root * root;
      s += w;
      sx += w * x[k];
      sy += w * y[k];
      sxx += w * x[k] * x[k];
      sxy += w * x[k] * y[k];
    }
    const double determinant = s * sxx - sx * sx;
    if (determinant <= 1e-6 * s * s) break;
    gain = (s * sxy - sx * sy) / determinant;
    offset = (sy - gain * sx) / s;
  }
  *grey = *grey * gain + offset;
}

// The mean of the closest values of which there are as many as kDensestShare asks for: what stands still
// shows alike in photos of which a thing that turns hides more than half.
float DensestOf(std::vector<float> values) {
  std::sort(values.begin(), values.end());
  const auto num = std::max<size_t>(
      2, static_cast<size_t>(std::lround(kDensestShare * static_cast<double>(values.size()))));
  if (values.size() <= num) return UpperMedian(std::move(values));
  size_t start = 0;
  for (size_t k = 1; k + num <= values.size(); ++k) {
    if (values[k + num - 1] - values[k] < values[start + num - 1] - values[start]) start = k;
  }
  return std::accumulate(values.begin() + static_cast<std::ptrdiff_t>(start),
                         values.begin() + static_cast<std::ptrdiff_t>(start + num), 0.0F) /
         static_cast<float>(num);
}

// Of each pixel's values over the photos, NaN left out.
template <typename Middle>
cv::Mat PixelByPixel(const std::vector<cv::Mat>& photos, const Middle& middle) {
  cv::Mat result(photos.front().size(), CV_32F);
  constexpr int64_t kPixelsAtATime = 4096;  // of a thread; each is short work
  ParallelFor(static_cast<int64_t>(result.total()), 0, kPixelsAtATime, [&](int64_t k) {
    std::vector<float> values;
    values.reserve(photos.size());
    for (const cv::Mat& photo : photos) {
      const float value = photo.ptr<float>()[k];
      if (!std::isnan(value)) values.push_back(value);
    }
    result.ptr<float>()[k] = values.empty() ? std::nanf("") : middle(std::move(values));
  });
  return result;
}

cv::Mat MedianOf(const std::vector<cv::Mat>& photos) {
  return PixelByPixel(photos, [](std::vector<float> values) { return UpperMedian(std::move(values)); });
}

// What photos show most of the time, and how far off one is by chance.
struct Still {
  cv::Mat grey;
  cv::Mat variance;  // of a pixel that did not change
};

Still StillPicture(const std::vector<cv::Mat>& photos, ChangeDetail detail) {
  Still still;
  still.grey = detail == ChangeDetail::kSilhouettes ? PixelByPixel(photos, DensestOf) : MedianOf(photos);
  const cv::Mat& grey = still.grey;
  cv::Mat dx;
  cv::Mat dy;
  cv::Mat filled = grey.clone();
  cv::patchNaNs(filled, 0);
  cv::Sobel(filled, dx, CV_32F, 1, 0, 3, 1.0 / 8);
  cv::Sobel(filled, dy, CV_32F, 0, 1, 3, 1.0 / 8);
  std::vector<float> sizes;
  for (const cv::Mat& photo : photos) {
    for (int k = 0; k < static_cast<int>(photo.total()); k += 7) {
      const float d = photo.ptr<float>()[k] - grey.ptr<float>()[k];
      if (!std::isnan(d)) sizes.push_back(std::abs(d));
    }
  }
  const float noise = std::max(kLeastNoise, static_cast<float>(kSigmaOfMad) * UpperMedian(std::move(sizes)));
  still.variance.create(grey.size(), CV_32F);
  for (int k = 0; k < static_cast<int>(grey.total()); ++k) {
    const float slope = kMisplacedPx * std::hypot(dx.ptr<float>()[k], dy.ptr<float>()[k]);
    still.variance.ptr<float>()[k] = noise * noise + slope * slope;
  }
  return still;
}

// Differences from the still picture in units of the noise, root mean square over 3 x 3 pixels.
std::vector<cv::Mat> Deviations(const std::vector<cv::Mat>& photos, const Still& still) {
  std::vector<cv::Mat> deviations(photos.size());
  ParallelFor(static_cast<int64_t>(photos.size()), 0, [&](int64_t i) {
    cv::Mat squared(still.grey.size(), CV_32F);
    for (int k = 0; k < static_cast<int>(squared.total()); ++k) {
      const float d = photos[i].ptr<float>()[k] - still.grey.ptr<float>()[k];
      squared.ptr<float>()[k] = std::isnan(d) ? 0.0F : d * d / still.variance.ptr<float>()[k];
    }
    cv::blur(squared, squared, {3, 3});
    cv::sqrt(squared, deviations[i]);
  });
  return deviations;
}

// Where patches differ from the still picture's by a factor and no more than unchanged pixels do.
cv::Mat Shades(const cv::Mat& photo, const Still& still) {
  cv::Mat is_known = photo == photo;
  is_known &= still.grey == still.grey;
  cv::Mat a = photo.clone();
  cv::Mat b = still.grey.clone();
  a.setTo(0, ~is_known);
  b.setTo(0, ~is_known);
  const auto mean = [](const cv::Mat& values) {
    cv::Mat result;
    cv::blur(values, result, {kShadePx, kShadePx});
    return result;
  };
  const cv::Mat ab = mean(a.mul(b));
  const cv::Mat residual = mean(a.mul(a)) - ab.mul(ab) / mean(b.mul(b));
  cv::Mat is_shade = residual < ChangeMap::kChangedSigmas * ChangeMap::kChangedSigmas * mean(still.variance);
  is_shade &= 1;
  return is_shade;
}

// 1 within the outer contours of what is set, without those of a smaller area [px].
cv::Mat Filled(const cv::Mat& mask, double least_area) {
  std::vector<std::vector<cv::Point>> contours;
  cv::findContours(mask, contours, cv::RETR_EXTERNAL, cv::CHAIN_APPROX_NONE);
  cv::Mat filled = cv::Mat::zeros(mask.size(), CV_8UC1);
  for (size_t c = 0; c < contours.size(); ++c) {
    if (cv::contourArea(contours[c]) < least_area) continue;
    cv::drawContours(filled, contours, static_cast<int>(c), cv::Scalar(1), cv::FILLED);
  }
  return filled;
}

// Where more than half of the photos change within `close` of a pixel, filled.
cv::Mat BusyPart(const std::vector<cv::Mat>& deviations, const cv::Mat& close) {
  cv::Mat count = cv::Mat::zeros(deviations.front().size(), CV_16UC1);
  for (const cv::Mat& deviation : deviations) {
    cv::Mat changed = deviation > static_cast<double>(ChangeMap::kChangedSigmas);
    cv::dilate(changed, changed, close);
    cv::add(count, cv::Scalar(1), count, changed);
  }
  return Filled(count > 0.5 * static_cast<double>(deviations.size()), 0);
}

StationChanges Activity(const std::vector<cv::Mat>& deviations) {
  const cv::Size size = deviations.front().size();
  const auto needed = std::max(2.0, std::ceil(kActivePhotos * static_cast<double>(deviations.size())));
  cv::Mat active(size, CV_8UC1);
  for (int k = 0; k < static_cast<int>(active.total()); ++k) {
    int count = 0;
    for (const cv::Mat& deviation : deviations)
      count += deviation.ptr<float>()[k] > static_cast<float>(ChangeMap::kChangedSigmas) ? 1 : 0;
    active.ptr<uint8_t>()[k] = count >= needed ? 1 : 0;
  }
  const int radius = std::max(1, static_cast<int>(kCloseShare * std::max(size.width, size.height)));
  const cv::Mat disc = cv::getStructuringElement(cv::MORPH_ELLIPSE, {2 * radius + 1, 2 * radius + 1});
  cv::copyMakeBorder(active, active, radius, radius, radius, radius, cv::BORDER_CONSTANT, cv::Scalar(0));
  cv::morphologyEx(active, active, cv::MORPH_CLOSE, disc);
  active = active(cv::Rect(radius, radius, size.width, size.height)).clone();
  const cv::Mat filled = Filled(active, kLeastAreaShare * static_cast<double>(active.total()));
  StationChanges changes;
  changes.is_active.assign(filled.datastart, filled.dataend);
  changes.active_share = cv::countNonZero(filled) / static_cast<double>(filled.total());
  const cv::Mat busy = BusyPart(deviations, disc);
  changes.is_busy.assign(busy.datastart, busy.dataend);
  return changes;
}

}  // namespace

double SceneChanges::MedianActiveShare() const {
  std::vector<double> shares;
  for (const StationChanges& station : stations) {
    if (!station.is_active.empty()) shares.push_back(station.active_share);
  }
  return UpperMedian(std::move(shares));
}

SceneChanges FindChanges(const std::vector<GreyPicture>& pictures, const PictureStations& stations,
                         ChangeDetail detail) {
  int num_stations = 0;
  for (const int station : stations.station_of_image) num_stations = std::max(num_stations, station + 1);
  std::vector<std::vector<int>> members(num_stations);
  for (size_t i = 0; i < pictures.size(); ++i)
    members[stations.station_of_image[i]].push_back(static_cast<int>(i));
  SceneChanges result;
  result.photos.resize(pictures.size());
  result.stations.resize(members.size());
  for (size_t s = 0; s < members.size(); ++s) {
    if (members[s].size() < kMinPhotos) continue;
    std::vector<cv::Mat> photos(members[s].size());
    // Exposures are matched to the first photo's, whatever changed in it, and then to the median's.
    const cv::Mat first = AsSeenFromFirst(pictures[members[s].front()], Eigen::Matrix3d::Identity());
    const auto num_photos = static_cast<int64_t>(photos.size());
    ParallelFor(num_photos, 0, [&](int64_t i) {
      photos[i] = AsSeenFromFirst(pictures[members[s][i]], stations.photo_from_first[members[s][i]]);
      MatchExposure(first, &photos[i]);
    });
    const cv::Mat rough = MedianOf(photos);
    ParallelFor(num_photos, 0, [&](int64_t i) { MatchExposure(rough, &photos[i]); });
    const Still still = StillPicture(photos, detail);
    const std::vector<cv::Mat> deviations = Deviations(photos, still);
    result.stations[s] = Activity(deviations);
    ParallelFor(num_photos, 0, [&](int64_t i) {
      const int image = members[s][i];
      const cv::Matx33d map_from_first = IndexMap(pictures[image], stations.photo_from_first[image]);
      cv::Mat in_photo;
      cv::warpPerspective(deviations[i], in_photo, map_from_first, deviations[i].size(), cv::INTER_LINEAR);
      in_photo.convertTo(in_photo, CV_8UC1, ChangeMap::kLevelsPerSigma);
      ChangeMap& map = result.photos[image];
      map.width = in_photo.cols;
      map.height = in_photo.rows;
      map.deviation.assign(in_photo.datastart, in_photo.dataend);
      if (detail != ChangeDetail::kSilhouettes) return;
      cv::warpPerspective(Shades(photos[i], still), in_photo, map_from_first, deviations[i].size(),
                          cv::INTER_NEAREST);
      map.is_shade.assign(in_photo.datastart, in_photo.dataend);
    });
  }
  return result;
}

bool IsBusy(const GreyPicture& picture, const Eigen::Matrix3d& photo_from_first,
            const StationChanges& changes, const Eigen::Vector2f& xy) {
  if (changes.is_busy.empty()) return true;
  const auto pixel = PixelOfFirst(picture, FirstFromPhoto(picture, photo_from_first), xy.cast<double>());
  return !pixel || changes.is_busy[*pixel] != 0;
}

std::vector<uint8_t> ActivePart(const GreyPicture& picture, const Eigen::Matrix3d& photo_from_first,
                                const StationChanges& changes) {
  std::vector<uint8_t> part;
  if (changes.is_active.empty()) return part;
  const Eigen::Matrix3d first_from_photo = FirstFromPhoto(picture, photo_from_first);
  part.assign(static_cast<size_t>(picture.photo_size.x()) * picture.photo_size.y(), 0);
  ParallelFor(picture.photo_size.y(), 0, [&](int64_t y) {
    for (int x = 0; x < picture.photo_size.x(); ++x) {
      const auto pixel = PixelOfFirst(picture, first_from_photo, {x + 0.5, static_cast<double>(y) + 0.5});
      if (pixel) part[static_cast<size_t>(y) * picture.photo_size.x() + x] = changes.is_active[*pixel];
    }
  });
  return part;
}

}  // namespace s2gs
