#include "s2gs/table/before_background.h"

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <mutex>
#include <optional>

#include "s2gs/image/background_votes.h"
#include "s2gs/image/picture_noise.h"
#include "s2gs/kernel/foreground.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

constexpr int kMargin = 2;           // [px], as far as a mask's edge blurs
constexpr int kReach = 32;           // [px], as far as plain surroundings are asked
constexpr int kLeastDirections = 3;  // of eight, from which plain surroundings enclose a pixel
// What lies about a pixel may itself differ much from photo to photo, as where a shadow or somebody passes: a
// range beyond which what turns is half as often as elsewhere tells little of what is between.
constexpr double kHalf = 0.5;
constexpr int64_t kGaussiansAtOnce = 256;

// What a station's photos show at a pixel where nothing turns.
struct Still {
  bool is_known = false;
  bool is_between = false;  // known by what is about the pixel alone
  std::array<uint8_t, 3> colour{};
  BackgroundRange range;
};

// What a station's photos show, by pixel.
struct StationVotes {
  std::vector<Still> stills;
  // By photo: how far it differs from that [grey values]; negative where it is not asked.
  std::vector<std::vector<float>> differences;
};

// How often what turns differs from the background by more than so many grey values.
class ThingDifferences {
 public:
  void Add(const Still& still, float difference) {
    ++counts_[LevelOf(difference)];
    ++all_.photos;
    all_.differ += difference > still.range.most ? 1 : 0;
  }
  void Add(const ThingDifferences& others) {
    for (size_t level = 0; level < kLevels; ++level) counts_[level] += others.counts_[level];
    all_.photos += others.all_.photos;
    all_.differ += others.all_.differ;
  }
  // Once all are added.
  void Sum() {
    BackgroundVotes of_level = all_;
    of_level.differ = of_level.photos;
    for (size_t level = 0; level < kLevels; ++level) {
      of_level.differ -= counts_[level];
      shares_[level] = ShareWhereSomethingIs(of_level);
    }
  }
  // Of those that differ by more than photos of the background do at their pixels.
  double Share() const { return ShareWhereSomethingIs(all_); }
  double ShareBeyond(double range) const { return shares_[LevelOf(range)]; }

 private:
  static constexpr size_t kLevels = 256;
  static size_t LevelOf(double difference) {
    return std::min(kLevels - 1, static_cast<size_t>(std::max(0.0, difference)));
  }

  BackgroundVotes all_;
  std::array<int, kLevels> counts_{};
  std::array<double, kLevels> shares_{};
};

// Per photo, the pixels about which it may show what turns.
using Covered = std::vector<std::vector<uint8_t>>;

// At a pixel, by the photos that show it uncovered.
Still StillAt(const StationPhotos& station, const Covered& covered, int x, int y) {
  Still still;
  const size_t at = static_cast<size_t>(y) * station.images.front().width + x;
  std::vector<size_t> shows;
  for (size_t k = 0; k < covered.size(); ++k) {
    if (covered[k][at] == 0) shows.push_back(k);
  }
  if (static_cast<int>(shows.size()) < kLeastBackgrounds) return still;
  still.is_known = true;
  std::vector<uint8_t> values;
  values.reserve(shows.size());
  for (int c = 0; c < 3; ++c) {
    values.clear();
    for (const size_t k : shows) values.push_back(station.images[k].Pixel(x, y)[c]);
    still.colour[c] = UpperMedian(values);
  }
  std::vector<double> differences;
  differences.reserve(shows.size());
  for (const size_t k : shows)
    differences.push_back(MostDifferentChannel(station.images[k].Pixel(x, y), still.colour.data()));
  still.range = FindBackgroundRange(&differences);
  return still;
}

// At a pixel that is covered in nearly all photos: where what is known in enough directions about it looks
// alike, by no more than photos differ there, the same between them.
Still BetweenKnown(const std::vector<Still>& known, int width, int height, int x, int y) {
  constexpr std::array<std::array<int, 2>, 8> kDirections = {
      {{1, 0}, {1, 1}, {0, 1}, {-1, 1}, {-1, 0}, {-1, -1}, {0, -1}, {1, -1}}};
  std::array<int, 3> least = {255, 255, 255};
  std::array<int, 3> most = {0, 0, 0};
  std::array<double, 3> sums{};
  double weights = 0;
  int found = 0;
  Still still;
  for (const auto& [dx, dy] : kDirections) {
    for (int step = 1; step <= kReach; ++step) {
      const int u = x + step * dx;
      const int v = y + step * dy;
      if (u < 0 || v < 0 || u >= width || v >= height) break;
      const Still& at = known[static_cast<size_t>(v) * width + u];
      if (!at.is_known) continue;
      ++found;
      const double weight = 1.0 / (step * std::hypot(dx, dy));
      weights += weight;
      for (int c = 0; c < 3; ++c) {
        least[c] = std::min<int>(least[c], at.colour[c]);
        most[c] = std::max<int>(most[c], at.colour[c]);
        sums[c] += weight * at.colour[c];
      }
      still.range.most = std::max(still.range.most, at.range.most);
      still.range.chance = found == 1 ? at.range.chance : std::max(still.range.chance, at.range.chance);
      break;
    }
  }
  if (found < kLeastDirections) return still;
  for (int c = 0; c < 3; ++c) {
    if (most[c] - least[c] > still.range.most) return still;
    still.colour[c] = static_cast<uint8_t>(std::lround(sums[c] / weights));
  }
  still.is_known = still.is_between = true;
  return still;
}

// By pixel: where any photo is covered, and about where nearly all are.
std::vector<Still> StillsOf(const StationPhotos& station, const Covered& covered) {
  const int width = station.images.front().width;
  const int height = station.images.front().height;
  std::vector<Still> known(static_cast<size_t>(width) * height);
  PixelMask asked{width, height, std::vector<uint8_t>(known.size(), 0)};
  for (const std::vector<uint8_t>& of_photo : covered) {
    for (size_t at = 0; at < known.size(); ++at) asked.inside[at] |= of_photo[at];
  }
  PixelMask unknown{width, height, std::vector<uint8_t>(known.size(), 0)};
  const auto ask = [&](const PixelMask& where, const PixelMask* but) {
    ParallelFor(height, 0, [&](int64_t y) {
      for (int x = 0; x < width; ++x) {
        const size_t at = static_cast<size_t>(y) * width + x;
        if (where.inside[at] == 0 || (but != nullptr && but->inside[at] != 0)) continue;
        known[at] = StillAt(station, covered, x, static_cast<int>(y));
        unknown.inside[at] = known[at].is_known ? 0 : 1;
      }
    });
  };
  ask(asked, nullptr);
  const PixelMask covered_in_most = unknown;
  ask(Widened(covered_in_most, kReach), &asked);
  std::vector<Still> stills = known;
  ParallelFor(height, 0, [&](int64_t y) {
    for (int x = 0; x < width; ++x) {
      const size_t at = static_cast<size_t>(y) * width + x;
      if (covered_in_most.inside[at] != 0)
        stills[at] = BetweenKnown(known, width, height, x, static_cast<int>(y));
    }
  });
  return stills;
}

// How far a station's photos differ from the background, within the masks and about them.
StationVotes VotesOf(const StationPhotos& station, const std::vector<PixelMask>& masks) {
  Covered covered;
  covered.reserve(masks.size());
  for (const PixelMask& mask : masks) covered.push_back(Widened(mask, kMargin).inside);
  const int width = station.images.front().width;
  const int height = station.images.front().height;
  StationVotes votes;
  votes.stills = StillsOf(station, covered);
  votes.differences.assign(masks.size(), std::vector<float>(votes.stills.size(), -1));
  ParallelFor(height, 0, [&](int64_t y) {
    for (int x = 0; x < width; ++x) {
      const size_t at = static_cast<size_t>(y) * width + x;
      const Still& still = votes.stills[at];
      if (!still.is_known) continue;
      for (size_t k = 0; k < covered.size(); ++k) {
        if (covered[k][at] == 0) continue;
        votes.differences[k][at] = static_cast<float>(
            MostDifferentChannel(station.images[k].Pixel(x, static_cast<int>(y)), still.colour.data()));
      }
    }
  });
  return votes;
}

// Calls `vote` with what each photo says of a Gaussian: the pixel's background and how far it differs.
template <typename Vote>
void ForEachVote(const std::vector<StationPhotos>& stations, const std::vector<StationVotes>& of_stations,
                 const Placement& gaussians, size_t i, const Vote& vote) {
  const float* centre = gaussians.centre.data() + 3 * i;
  const Eigen::Vector3d x_in_object(centre[0], centre[1], centre[2]);
  if (!x_in_object.allFinite() || !IsForeground(gaussians.foreground_logit[i])) return;
  for (size_t s = 0; s < stations.size(); ++s) {
    for (size_t k = 0; k < stations[s].views.size(); ++k) {
      const PinholeView& view = stations[s].views[k];
      const std::optional<Eigen::Vector2d> pixel = PixelOf(view, view.cam_from_object * x_in_object);
      if (!pixel ||
          !(pixel->x() >= 0 && pixel->y() >= 0 && pixel->x() < view.width && pixel->y() < view.height)) {
        continue;
      }
      const size_t at = static_cast<size_t>(pixel->y()) * view.width + static_cast<size_t>(pixel->x());
      const float difference = of_stations[s].differences[k][at];
      if (difference >= 0) vote(of_stations[s].stills[at], difference);
    }
  }
}

}  // namespace

std::vector<uint32_t> FindShowingBackground(const std::vector<StationPhotos>& stations,
                                            const std::vector<std::vector<PixelMask>>& masks,
                                            const Placement& gaussians) {
  std::vector<StationVotes> of_stations;
  of_stations.reserve(stations.size());
  for (size_t s = 0; s < stations.size(); ++s) of_stations.push_back(VotesOf(stations[s], masks[s]));
  const auto num = static_cast<int64_t>(gaussians.size());
  // Where photos show the pixel's background themselves.
  ThingDifferences of_thing;
  std::mutex adding;
  ParallelFor((num + kGaussiansAtOnce - 1) / kGaussiansAtOnce, 0, [&](int64_t part) {
    ThingDifferences of_part;
    const int64_t end = std::min(num, (part + 1) * kGaussiansAtOnce);
    for (int64_t i = part * kGaussiansAtOnce; i < end; ++i) {
      ForEachVote(stations, of_stations, gaussians, static_cast<size_t>(i),
                  [&](const Still& still, float difference) {
                    if (!still.is_between) of_part.Add(still, difference);
                  });
    }
    const std::lock_guard<std::mutex> lock(adding);
    of_thing.Add(of_part);
  });
  of_thing.Sum();
  const double as_thing = of_thing.Share();
  std::vector<BackgroundVotes> votes(gaussians.size());
  ParallelFor(num, 0, kGaussiansAtOnce, [&](int64_t i) {
    ForEachVote(stations, of_stations, gaussians, static_cast<size_t>(i),
                [&](const Still& still, float difference) {
                  if (still.is_between && of_thing.ShareBeyond(still.range.most) < kHalf * as_thing) return;
                  ++votes[i].photos;
                  votes[i].differ += difference > still.range.most ? 1 : 0;
                  votes[i].chance += still.range.chance;
                });
  });
  const auto asked = static_cast<int>(
      std::count_if(votes.begin(), votes.end(), [](const BackgroundVotes& of) { return of.photos > 0; }));
  std::vector<uint32_t> showing;
  for (size_t i = 0; i < votes.size(); ++i) {
    if (Weigh(votes[i], as_thing, asked) == BackgroundSight::kNotThere)
      showing.push_back(static_cast<uint32_t>(i));
  }
  return showing;
}

}  // namespace s2gs
