#include "sfm_split/split/station_pictures.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <utility>

#include "sfm_split/base/median_of_pictures.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/pictures/still_picture.h"
#include "sfm_split/pictures/what_stays.h"

namespace s2gs {
namespace {

using Verdict = PictureComparison::Verdict;

// Chance, where order speaks for a place: a camera that is carried off and put back to the pixel is so
// unlikely that agreement which chance has once in twenty is enough. A judgement.
constexpr double kLogChanceBetween = -3;

PictureStandard StandardOf(const GreyPicture& picture, const StationOptions& options,
                           bool to_border = false) {
  return {picture, options.max_shake_px, options.min_unmoved_share, options.min_cells, to_border};
}

std::map<int, size_t> PhotosOfStations(const PictureStations& stations) {
  std::map<int, size_t> num_photos;
  for (const int station : stations.station_of_image) ++num_photos[station];
  return num_photos;
}

std::vector<int> StillAmong(const std::vector<PictureComparison>& comparisons) {
  std::vector<int> still;
  for (size_t i = 0; i < comparisons.size(); ++i) {
    if (comparisons[i].verdict == Verdict::kStill) still.push_back(static_cast<int>(i));
  }
  return still;
}

// What a motion between pictures is between photos.
Eigen::Matrix3d InPhotos(const Eigen::Matrix3d& H, const GreyPicture& picture) {
  const Eigen::Vector2d scale = picture.Scale();
  const Eigen::Matrix3d to_photo = Eigen::Vector3d(scale.x(), scale.y(), 1).asDiagonal();
  return to_photo * H * to_photo.inverse();
}

// Takes photos in that show what the others show without what turns: one of them, which the rest were
// compared with, has its share of the thing before the wall, and of a plain wall's few tiles that is many.
// \param still   pictures in the standard's frame, those of members apart. \param images  those that were
// compared. \param by_chance  what agrees need be no share of all there is.
void TakeInByMedian(const std::vector<GreyPicture>& pictures, std::vector<const GreyPicture*> still,
                    const std::vector<int>& images, const StationOptions& options, bool by_chance,
                    std::vector<PictureComparison>* comparisons, std::vector<int>* members) {
  const std::vector<const GreyPicture*> apart = still;
  std::vector<char> is_taken(images.size(), 0);
  for (const int m : *members) is_taken[m] = 1;
  for (size_t num_before = 0; members->size() > num_before;) {
    if (members->size() + apart.size() < kPicturesForMedian || members->size() == images.size()) return;
    num_before = members->size();
    std::vector<GreyPicture> steadied(members->size());
    ParallelFor(static_cast<int64_t>(members->size()), 0, [&](int64_t k) {
      const int m = (*members)[k];
      steadied[k] = SeenFrom((*comparisons)[m].second_from_first, pictures[images[m]]);
    });
    still = apart;
    for (const GreyPicture& picture : steadied) still.push_back(&picture);
    const PictureStandard median = StandardOf(MedianPicture(still), options, true);
    std::vector<PictureComparison> anew(images.size());
    ParallelFor(static_cast<int64_t>(images.size()), 0,
                [&](int64_t i) { anew[i] = median.CompareWith(pictures[images[i]]); });
    CompareWithoutPassing(median, pictures, images, *members, &anew);
    const WhatStays stays(anew, *members);
    for (size_t i = 0; i < images.size(); ++i) {
      // The members', too: a median tells their shake better than one photo did, and so the next median.
      const bool agrees =
          by_chance ? anew[i].log_chance <= kMaxLogChance : anew[i].verdict == Verdict::kStill;
      if (!agrees || (is_taken[i] == 0 && stays.HasMovedIn(anew[i]))) continue;
      (*comparisons)[i] = std::move(anew[i]);
      is_taken[i] = 1;
    }
    members->clear();
    for (size_t i = 0; i < images.size(); ++i) {
      if (is_taken[i] != 0) members->push_back(static_cast<int>(i));
    }
  }
}

// Logarithm of how likely chance has half of the pictures agree as well as they do: what share agreeing tiles
// are of all says how much of the picture turns, and is not asked. Two that look alike do not speak for all.
double LogChanceOfHalf(std::vector<double> log_chances) {
  const size_t half = log_chances.size() / 2;
  std::nth_element(log_chances.begin(), log_chances.begin() + static_cast<std::ptrdiff_t>(half - 1),
                   log_chances.end());
  const auto num = static_cast<double>(log_chances.size());
  const auto k = static_cast<double>(half);
  const double log_choices = std::lgamma(num + 1) - std::lgamma(k + 1) - std::lgamma(num - k + 1);
  return log_choices + k * log_chances[half - 1];
}

// Order says that a camera stood at a place, not how it moved there.
void KeepProvenMotion(PictureComparison* comparison) {
  if (comparison->log_chance > kMaxLogChance) comparison->second_from_first.setIdentity();
}

// Photos of a window in which the camera stood still, and those that show what its median shows.
// \param comparisons  of all loose photos with the window's median, those of the window with that of the
// others.
std::vector<int> FindStillWindow(const std::vector<const GreyPicture*>& loose, size_t begin, size_t size,
                                 const StationOptions& options, std::vector<PictureComparison>* comparisons) {
  std::vector<int> members;
  const std::vector<const GreyPicture*> window(loose.begin() + static_cast<std::ptrdiff_t>(begin),
                                               loose.begin() + static_cast<std::ptrdiff_t>(begin + size));
  const bool is_one_size = std::all_of(window.begin(), window.end(), [&](const GreyPicture* picture) {
    return picture->width == window.front()->width && picture->height == window.front()->height;
  });
  if (!is_one_size) return members;
  const PictureStandard median = StandardOf(MedianPicture(window), options, true);
  std::vector<double> log_chances(size);
  const auto stand_still = [&] {
    for (size_t k = 0; k < size; ++k) log_chances[k] = (*comparisons)[begin + k].log_chance;
    return LogChanceOfHalf(log_chances) <= kMaxLogChance;
  };
  ParallelFor(static_cast<int64_t>(size), 0,
              [&](int64_t k) { (*comparisons)[begin + k] = median.CompareWith(*window[k]); });
  if (!stand_still()) return members;
  ParallelFor(static_cast<int64_t>(size), 0, [&](int64_t k) {
    std::vector<const GreyPicture*> others = window;
    others.erase(others.begin() + k);
    (*comparisons)[begin + k] = StandardOf(MedianPicture(others), options, true).CompareWith(*window[k]);
  });
  if (!stand_still()) return members;
  ParallelFor(static_cast<int64_t>(loose.size()), 0, [&](int64_t i) {
    const auto at = static_cast<size_t>(i);
    if (at < begin || at >= begin + size) (*comparisons)[at] = median.CompareWith(*loose[at]);
  });
  for (size_t i = 0; i < loose.size(); ++i) {
    const bool is_in_window = i >= begin && i < begin + size;
    PictureComparison& comparison = (*comparisons)[i];
    if (comparison.log_chance > (is_in_window ? kLogChanceBetween : kMaxLogChance)) continue;
    members.push_back(static_cast<int>(i));
    KeepProvenMotion(&comparison);
  }
  return members;
}

// Where what turns fills the pictures, as on a plain disc before a plain wall, no photo tells what stays: its
// tiles are the thing's, and of the table's rim and a shadow's edge each photo has its own share. The median
// of photos that follow one another has what stays alone, if the camera stood still, and the more of a turn
// they span, the less of the thing: so this is tried of photos whose stations are in doubt, of few and of
// many, and what most photos agree with is taken. \param loose  these, in their order.
void FindStationsByMedians(const std::vector<GreyPicture>& pictures, std::vector<int> loose,
                           const StationOptions& options, Reporter& reporter, PictureStations* stations) {
  size_t begin = 0;
  while (begin + kPicturesForMedian <= loose.size()) {
    if (reporter.StopRequested()) throw Interrupted();
    std::vector<const GreyPicture*> shown;
    shown.reserve(loose.size());
    for (const int image : loose) shown.push_back(&pictures[image]);
    std::vector<PictureComparison> comparisons;
    std::vector<int> members;
    for (const size_t size : {kPicturesForMedian, 2 * kPicturesForMedian, 3 * kPicturesForMedian}) {
      if (begin + size > loose.size()) break;
      std::vector<PictureComparison> by_window(loose.size());
      std::vector<int> still = FindStillWindow(shown, begin, size, options, &by_window);
      if (still.empty()) continue;
      LeaveOutMoved(by_window, &still);
      TakeInByMedian(pictures, {}, loose, options, true, &by_window, &still);
      if (still.size() <= members.size()) continue;
      members = std::move(still);
      comparisons = std::move(by_window);
    }
    if (members.size() < kMinPersistencePhotos) {
      begin += kPicturesForMedian / 2;
      continue;
    }
    const Eigen::Matrix3d median_from_first = comparisons[members.front()].second_from_first.inverse();
    const int station = static_cast<int>(pictures.size()) + loose[members.front()];
    for (const int m : members) {
      stations->station_of_image[loose[m]] = station;
      stations->photo_from_first[loose[m]] =
          InPhotos(comparisons[m].second_from_first * median_from_first, pictures[loose[m]]);
    }
    loose.erase(std::remove_if(loose.begin(), loose.end(),
                               [&](int image) { return stations->station_of_image[image] == station; }),
                loose.end());
    begin = 0;
  }
}

// Photos of stations that are too small for what stays in them to show, and of those that alternate in the
// photos' order, none of them with most: a camera is not put back to the pixel time and again, so that these
// are more likely what turns, seen alike. Photos whose names say nothing alternate, too, and then their
// medians say that the camera moved.
std::vector<int> LoosePhotos(const PictureStations& stations) {
  const std::vector<int>& of_image = stations.station_of_image;
  std::map<int, size_t> num_photos = PhotosOfStations(stations);
  std::map<int, size_t> last_of;
  for (size_t i = 0; i < of_image.size(); ++i) last_of[of_image[i]] = i;
  std::vector<int> loose;
  for (size_t begin = 0, end = 0; begin < of_image.size(); begin = end) {
    size_t most = 0;  // of one station, among those that alternate
    end = begin + 1;
    for (size_t i = begin; i < end; ++i) {
      end = std::max(end, last_of[of_image[i]] + 1);
      most = std::max(most, num_photos[of_image[i]]);
    }
    const bool is_settled = 2 * most > end - begin;
    for (size_t i = begin; i < end; ++i) {
      if (!is_settled || num_photos[of_image[i]] < kMinPersistencePhotos)
        loose.push_back(static_cast<int>(i));
    }
  }
  return loose;
}

// A station's photos, as its first one's camera would show them.
std::vector<GreyPicture> SteadiedPictures(const std::vector<GreyPicture>& pictures,
                                          const PictureStations& stations, const std::vector<int>& images) {
  std::vector<GreyPicture> steadied(images.size());
  ParallelFor(static_cast<int64_t>(images.size()), 0, [&](int64_t k) {
    const Eigen::Vector2d scale = pictures[images[k]].Scale();
    const Eigen::Matrix3d to_photo = Eigen::Vector3d(scale.x(), scale.y(), 1).asDiagonal();
    steadied[k] =
        SeenFrom(to_photo.inverse() * stations.photo_from_first[images[k]] * to_photo, pictures[images[k]]);
  });
  return steadied;
}

// Per photo of a station that is too small for what stays in it to show: the station that has the nearest
// photos of larger ones before and after it, in their order; -1 where these are two, and of other photos.
std::vector<int> StationsAround(const PictureStations& stations) {
  const std::vector<int>& of_image = stations.station_of_image;
  std::map<int, size_t> num_photos = PhotosOfStations(stations);
  std::vector<int> around(of_image.size(), -1);
  int before = -1;
  for (size_t begin = 0, end = 0; begin < of_image.size(); begin = end) {
    const bool is_small = num_photos[of_image[begin]] < kMinPersistencePhotos;
    for (end = begin + 1; is_small && end < of_image.size(); ++end) {
      if (num_photos[of_image[end]] >= kMinPersistencePhotos) break;
    }
    const int after = is_small && end < of_image.size() ? of_image[end] : -1;
    for (size_t i = begin; i < end && after == before; ++i) around[i] = after;
    before = of_image[end - 1];
  }
  return around;
}

// Joins stations whose medians, or a smaller one's first photo, show that the camera stood still: each has
// had a photo for its standard, and what that shows of the thing is not what the other's photos show. Of a
// few photos amid a station's less is asked.
void JoinByMedians(const std::vector<GreyPicture>& pictures, const StationOptions& options,
                   Reporter& reporter, PictureStations* stations) {
  std::map<int, std::vector<int>> images;
  for (size_t i = 0; i < pictures.size(); ++i)
    images[stations->station_of_image[i]].push_back(static_cast<int>(i));
  const std::vector<int> around = StationsAround(*stations);
  std::vector<int> by_size;
  std::map<int, GreyPicture> shown;
  for (const auto& [station, members] : images) {
    by_size.push_back(station);
    std::vector<GreyPicture> steadied;
    if (members.size() >= kMinPersistencePhotos) steadied = SteadiedPictures(pictures, *stations, members);
    std::vector<const GreyPicture*> still;
    still.reserve(steadied.size());
    for (const GreyPicture& picture : steadied) still.push_back(&picture);
    shown.emplace(station, still.empty() ? pictures[members.front()] : MedianPicture(still));
  }
  std::stable_sort(by_size.begin(), by_size.end(),
                   [&](int a, int b) { return images[a].size() > images[b].size(); });
  for (size_t a = 0; a + 1 < by_size.size() && images[by_size[a]].size() >= kPicturesForMedian; ++a) {
    if (reporter.StopRequested()) throw Interrupted();
    const std::vector<int> kept = images[by_size[a]];
    if (stations->station_of_image[kept.front()] != by_size[a]) continue;  // joined to a larger one
    const GreyPicture& picture = shown.at(by_size[a]);
    const PictureStandard standard = StandardOf(picture, options, true);
    std::vector<PictureComparison> comparisons(by_size.size());
    ParallelFor(static_cast<int64_t>(by_size.size() - a - 1), 0, [&](int64_t k) {
      comparisons[a + 1 + k] = standard.CompareWith(shown.at(by_size[a + 1 + k]));
    });
    const auto is_between = [&](size_t b) {
      const std::vector<int>& joined = images[by_size[b]];
      return comparisons[b].log_chance <= kLogChanceBetween &&
             std::all_of(joined.begin(), joined.end(),
                         [&](int image) { return around[image] == by_size[a]; });
    };
    bool is_any = false;
    for (size_t b = a + 1; b < by_size.size(); ++b)
      is_any |= comparisons[b].log_chance <= kMaxLogChance || is_between(b);
    if (!is_any) continue;
    std::vector<PictureComparison> of_kept(kept.size());
    ParallelFor(static_cast<int64_t>(kept.size()), 0,
                [&](int64_t k) { of_kept[k] = standard.CompareWith(pictures[kept[k]]); });
    std::vector<int> all(kept.size());
    std::iota(all.begin(), all.end(), 0);
    const WhatStays stays(of_kept, all);
    for (size_t b = a + 1; b < by_size.size(); ++b) {
      const std::vector<int>& joined = images[by_size[b]];
      if (stations->station_of_image[joined.front()] != by_size[b]) continue;
      const bool is_still = comparisons[b].log_chance <= kMaxLogChance && !stays.HasMovedIn(comparisons[b]);
      if (!is_between(b) && !is_still) continue;
      KeepProvenMotion(&comparisons[b]);
      const Eigen::Matrix3d joined_from_kept = InPhotos(comparisons[b].second_from_first, picture);
      for (const int image : joined) {
        stations->station_of_image[image] = by_size[a];
        stations->photo_from_first[image] = stations->photo_from_first[image] * joined_from_kept;
      }
    }
  }
}

// What turns and fills the picture moves as one from photo to photo, by as much as a tripod shakes: only the
// median of many photos takes it apart from what stays, so that in fewer no motion is told.
void KeepMotionsOfMany(PictureStations* stations) {
  std::map<int, size_t> num_photos = PhotosOfStations(*stations);
  for (size_t i = 0; i < stations->station_of_image.size(); ++i) {
    if (num_photos[stations->station_of_image[i]] < kPicturesForMedian)
      stations->photo_from_first[i].setIdentity();
  }
}

// In the order of first photos, which what was left of a station may have another of.
void Renumber(PictureStations* stations) {
  std::map<int, std::pair<int, Eigen::Matrix3d>> of_old;  // new number, first photo from the old first one
  for (size_t i = 0; i < stations->station_of_image.size(); ++i) {
    const auto [found, is_new] =
        of_old.try_emplace(stations->station_of_image[i], static_cast<int>(of_old.size()),
                           stations->photo_from_first[i].inverse());
    stations->station_of_image[i] = found->second.first;
    stations->photo_from_first[i] = stations->photo_from_first[i] * found->second.second;
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
    const PictureStandard standard = StandardOf(picture, options);
    std::vector<PictureComparison> comparisons(left.size());
    ParallelFor(static_cast<int64_t>(left.size()), 0,
                [&](int64_t i) { comparisons[i] = standard.CompareWith(pictures[left[i]]); });
    CompareByWhatStays(standard, pictures, left, &comparisons);
    std::vector<int> members = StillAmong(comparisons);
    CompareWithoutPassing(standard, pictures, left, members, &comparisons);
    LeaveOutMoved(comparisons, &members);
    TakeInByMedian(pictures, {&picture}, left, options, false, &comparisons, &members);
    result.station_of_image[first] = num_stations;
    for (const int m : members) {
      result.station_of_image[left[m]] = num_stations;
      result.photo_from_first[left[m]] = InPhotos(comparisons[m].second_from_first, picture);
    }
    left.erase(std::remove_if(left.begin(), left.end(),
                              [&](int image) { return result.station_of_image[image] >= 0; }),
               left.end());
    ++num_stations;
    reporter.Progress("compare pictures", static_cast<int64_t>(pictures.size() - left.size()),
                      static_cast<int64_t>(pictures.size()));
  }
  FindStationsByMedians(pictures, LoosePhotos(result), options, reporter, &result);
  JoinByMedians(pictures, options, reporter, &result);
  KeepMotionsOfMany(&result);
  Renumber(&result);
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
    const PictureStandard standard = StandardOf(pictures[join.image1], options);
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
