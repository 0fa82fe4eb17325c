#include "sfm_split/split/station_pictures.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

using Verdict = PictureComparison::Verdict;

constexpr double kMinPersistence = 0.5;  // of a station's photos in which a tile of the background is found
constexpr size_t kMinPersistencePhotos = 4;  // half of fewer is one photo
constexpr double kMaxMovedShare =
    0.25;  // of that background that may lie elsewhere in a photo of the station
// Fewer lie elsewhere by chance in a crowd of tiles: a debt, chosen and not derived.
constexpr int kMinMovedTiles = 4;
// Of a camera that stands still: of fewer what turns is in their median.
constexpr size_t kPicturesForMedian = 8;
// Of tiles that lie elsewhere, beyond as many as in the other photos, in standard deviations: one in 160.
constexpr double kMovedSigmas = 2.5;

// What is found in few of a station's photos turns or passes by. It may move as one from photo to photo, and
// be taken for the camera's own motion, and where it fills the picture what stays is a small share of all:
// such photos are compared again by what stays alone.
void CompareByWhatStays(const PictureStandard& standard, const std::vector<GreyPicture>& pictures,
                        const std::vector<int>& images, std::vector<PictureComparison>* comparisons) {
  const auto is_still = [](const PictureComparison& comparison) {
    return comparison.verdict == Verdict::kStill;
  };
  const auto num_still = std::count_if(comparisons->begin(), comparisons->end(), is_still);
  if (num_still < static_cast<std::ptrdiff_t>(kMinPersistencePhotos)) return;
  std::vector<int> num_found(std::find_if(comparisons->begin(), comparisons->end(), is_still)->tiles.size(),
                             0);
  for (const PictureComparison& comparison : *comparisons) {
    for (size_t t = 0; is_still(comparison) && t < num_found.size(); ++t)
      num_found[t] += comparison.tiles[t].is_found ? 1 : 0;
  }
  std::vector<char> is_passing;
  is_passing.reserve(num_found.size());
  for (const int num : num_found)
    is_passing.push_back(num < kMinPersistence * static_cast<double>(num_still) ? 1 : 0);
  ParallelFor(static_cast<int64_t>(images.size()), 0, [&](int64_t i) {
    PictureComparison& comparison = (*comparisons)[i];
    if (is_still(comparison) && comparison.second_from_first.isIdentity()) return;
    PictureComparison without = standard.CompareWith(pictures[images[i]], is_passing);
    if (is_still(without)) comparison = std::move(without);
  });
}

// Leaves those members out in which much of what stays in place in most of them lies elsewhere. A tile of
// little texture before noise, of a checked cloth or of what turns lies elsewhere now and then in every
// photo: only more of them than that makes a photo of another place.
void LeaveOutMoved(const std::vector<PictureComparison>& comparisons, std::vector<int>* members) {
  if (members->size() < kMinPersistencePhotos) return;
  const size_t num_tiles = comparisons[members->front()].tiles.size();
  std::vector<int> num_found(num_tiles, 0);
  std::vector<int> num_elsewhere(num_tiles, 0);
  for (const int m : *members) {
    for (size_t t = 0; t < num_tiles; ++t) {
      const TileMatch& tile = comparisons[m].tiles[t];
      num_found[t] += tile.is_found ? 1 : 0;
      num_elsewhere[t] += tile.is_found && !tile.agrees ? 1 : 0;
    }
  }
  const double needed = kMinPersistence * static_cast<double>(members->size());
  const auto has_moved = [&](int m) {
    int num_moved = 0;
    int num = 0;
    double expected = 0;
    double variance = 0;
    for (size_t t = 0; t < num_tiles; ++t) {
      const TileMatch& tile = comparisons[m].tiles[t];
      if (!tile.is_found || num_found[t] < needed) continue;
      const double share = num_elsewhere[t] / static_cast<double>(num_found[t]);
      expected += share;
      variance += share * (1 - share);
      ++num;
      num_moved += tile.agrees ? 0 : 1;
    }
    return num_moved >= kMinMovedTiles && num_moved > kMaxMovedShare * num &&
           num_moved - expected > kMovedSigmas * std::sqrt(variance);
  };
  members->erase(std::remove_if(members->begin(), members->end(), has_moved), members->end());
}

// What a camera that stands still sees, of pictures in which it did: what turns or passes by is not in it,
// and noise and compression hardly. Photos of other exposures are brought to the first one's light.
GreyPicture MedianPicture(const std::vector<const GreyPicture*>& pictures) {
  GreyPicture median = *pictures.front();
  std::vector<double> gain;
  const auto sum = [](const GreyPicture& picture) {
    return std::accumulate(picture.grey.begin(), picture.grey.end(), 1.0);
  };
  gain.reserve(pictures.size());
  for (const GreyPicture* picture : pictures) gain.push_back(sum(median) / sum(*picture));
  ParallelFor(median.height, 0, [&](int64_t y) {
    std::vector<double> values(pictures.size());
    for (size_t i = static_cast<size_t>(y) * median.width; i < (static_cast<size_t>(y) + 1) * median.width;
         ++i) {
      for (size_t k = 0; k < pictures.size(); ++k) values[k] = gain[k] * pictures[k]->grey[i];
      median.grey[i] = static_cast<uint8_t>(std::lround(std::min(255.0, UpperMedian(values))));
    }
  });
  return median;
}

// Takes photos in that show what the others show without what turns: one of them, which the rest were
// compared with, has its share of the thing before the wall, and of a plain wall's few tiles that is many.
// \param first  the station's standard. \param images  those that were compared.
void TakeInByMedian(const std::vector<GreyPicture>& pictures, int first, const std::vector<int>& images,
                    const StationOptions& options, std::vector<PictureComparison>* comparisons,
                    std::vector<int>* members) {
  std::vector<const GreyPicture*> still = {&pictures[first]};
  for (const int m : *members) {
    if ((*comparisons)[m].second_from_first.isIdentity()) still.push_back(&pictures[images[m]]);
  }
  if (still.size() < kPicturesForMedian || members->size() == images.size()) return;
  const PictureStandard median(MedianPicture(still), options.max_shake_px, options.min_unmoved_share,
                               options.min_cells);
  std::vector<char> is_taken(images.size(), 0);
  for (const int m : *members) is_taken[m] = 1;
  ParallelFor(static_cast<int64_t>(images.size()), 0, [&](int64_t i) {
    if (is_taken[i] != 0) return;
    PictureComparison comparison = median.CompareWith(pictures[images[i]]);
    if (comparison.verdict != Verdict::kStill) return;
    int num_found = 0;
    for (const TileMatch& tile : comparison.tiles) num_found += tile.is_found ? 1 : 0;
    if (num_found - comparison.num_agreeing > kMaxMovedShare * num_found) return;
    (*comparisons)[i] = std::move(comparison);
    is_taken[i] = 1;
  });
  members->clear();
  for (size_t i = 0; i < images.size(); ++i) {
    if (is_taken[i] != 0) members->push_back(static_cast<int>(i));
  }
}

Eigen::Matrix3d Translation(const Eigen::Vector2f& shift) {
  Eigen::Matrix3d T = Eigen::Matrix3d::Identity();
  T.topRightCorner<2, 1>() = shift.cast<double>();
  return T;
}

Eigen::Vector2d Middle(const GreyPicture& picture) { return 0.5 * picture.photo_size.cast<double>(); }

}  // namespace

PictureStations FindPictureStations(const std::vector<GreyPicture>& pictures, const StationOptions& options,
                                    Reporter& reporter) {
  PictureStations result;
  result.station_of_image.assign(pictures.size(), -1);
  result.photo_from_first.assign(pictures.size(), Eigen::Matrix3d::Identity());
  std::vector<int> left(pictures.size());
  std::iota(left.begin(), left.end(), 0);
  int num_stations = 0;
  while (!left.empty()) {
    if (reporter.StopRequested()) throw Interrupted();
    const int first = left.front();
    left.erase(left.begin());
    const GreyPicture& picture = pictures[first];
    const PictureStandard standard(picture, options.max_shake_px, options.min_unmoved_share,
                                   options.min_cells);
    std::vector<PictureComparison> comparisons(left.size());
    ParallelFor(static_cast<int64_t>(left.size()), 0,
                [&](int64_t i) { comparisons[i] = standard.CompareWith(pictures[left[i]]); });
    CompareByWhatStays(standard, pictures, left, &comparisons);
    std::vector<int> members;
    for (size_t i = 0; i < left.size(); ++i) {
      if (comparisons[i].verdict == Verdict::kStill) members.push_back(static_cast<int>(i));
    }
    LeaveOutMoved(comparisons, &members);
    TakeInByMedian(pictures, first, left, options, &comparisons, &members);
    result.station_of_image[first] = num_stations;
    const Eigen::Vector2d scale = picture.Scale();
    const Eigen::Matrix3d to_photo = Eigen::Vector3d(scale.x(), scale.y(), 1).asDiagonal();
    for (const int m : members) {
      result.station_of_image[left[m]] = num_stations;
      result.photo_from_first[left[m]] = to_photo * comparisons[m].second_from_first * to_photo.inverse();
    }
    left.erase(std::remove_if(left.begin(), left.end(),
                              [&](int image) { return result.station_of_image[image] >= 0; }),
               left.end());
    ++num_stations;
    reporter.Progress("compare pictures", static_cast<int64_t>(pictures.size() - left.size()),
                      static_cast<int64_t>(pictures.size()));
  }
  return result;
}

Stations JoinStations(const std::vector<GreyPicture>& pictures, const PictureStations& by_picture,
                      const std::vector<StationJoin>& joins, const StationOptions& options) {
  const size_t num = pictures.size();
  std::vector<int> group = by_picture.station_of_image;
  std::vector<Eigen::Matrix3d> from_group = by_picture.photo_from_first;
  const auto shake_of = [&](const Eigen::Matrix3d& H, const GreyPicture& picture) {
    const Eigen::Vector3d moved = H * Middle(picture).homogeneous();
    return Eigen::Vector2d(moved.hnormalized() - Middle(picture));
  };
  for (const StationJoin& join : joins) {
    const int kept = group[join.image1];
    const int joined = group[join.image2];
    if (kept == joined) continue;
    const PictureStandard standard(pictures[join.image1], options.max_shake_px, options.min_unmoved_share,
                                   options.min_cells);
    if (standard.CompareWith(pictures[join.image2]).verdict == Verdict::kMoved) continue;
    const Eigen::Matrix3d joined_from_kept =
        from_group[join.image2].inverse() * Translation(join.shift) * from_group[join.image1];
    Eigen::AlignedBox2d box;
    for (size_t i = 0; i < num; ++i) {
      if (group[i] == kept) box.extend(shake_of(from_group[i], pictures[i]));
      if (group[i] == joined) box.extend(shake_of(from_group[i] * joined_from_kept, pictures[i]));
    }
    if (box.sizes().maxCoeff() > options.max_shake_px) continue;
    for (size_t i = 0; i < num; ++i) {
      if (group[i] != joined) continue;
      group[i] = kept;
      from_group[i] = from_group[i] * joined_from_kept;
    }
  }

  Stations stations;
  stations.station_of_image.assign(num, -1);
  std::vector<int> station_of_group(num, -1);
  for (size_t i = 0; i < num; ++i) {
    int& station = station_of_group[group[i]];
    if (station < 0) {
      station = static_cast<int>(stations.images.size());
      stations.images.emplace_back();
    }
    stations.station_of_image[i] = station;
    stations.images[station].push_back(static_cast<int>(i));
    const int first = stations.images[station].front();
    stations.photo_from_first.emplace_back(from_group[i] * from_group[first].inverse());
    stations.shift.emplace_back(shake_of(stations.photo_from_first.back(), pictures[i]).cast<float>());
  }
  return stations;
}

}  // namespace s2gs
