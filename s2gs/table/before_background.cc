#include "s2gs/table/before_background.h"

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstddef>
#include <optional>

#include "s2gs/image/background_votes.h"
#include "s2gs/image/picture_noise.h"
#include "s2gs/kernel/foreground.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

constexpr int kMargin = 2;  // [px], as far as a mask's edge blurs
constexpr int64_t kGaussiansAtOnce = 256;

// At the pixels of one photo.
enum class Pixel : uint8_t { kUnknown, kSame, kDiffers };

struct PhotoVotes {
  std::vector<Pixel> pixels;
  std::vector<float> chances;  // of the photo to differ by chance
};

// Which pixels of a station's photos differ from the background, within the masks and about them.
std::vector<PhotoVotes> VotesOf(const StationPhotos& station, const std::vector<PixelMask>& masks) {
  std::vector<std::vector<uint8_t>> covered;
  covered.reserve(masks.size());
  for (const PixelMask& mask : masks) covered.push_back(Widened(mask, kMargin).inside);
  const int width = station.images.front().width;
  const int height = station.images.front().height;
  std::vector<PhotoVotes> votes(masks.size());
  for (PhotoVotes& of : votes) {
    of.pixels.assign(static_cast<size_t>(width) * height, Pixel::kUnknown);
    of.chances.assign(of.pixels.size(), 0);
  }
  ParallelFor(height, 0, [&](int64_t y) {
    std::vector<size_t> shows;  // photos of the background
    std::vector<uint8_t> values;
    std::vector<double> differences;
    for (int x = 0; x < width; ++x) {
      const size_t at = static_cast<size_t>(y) * width + x;
      shows.clear();
      for (size_t k = 0; k < covered.size(); ++k) {
        if (covered[k][at] == 0) shows.push_back(k);
      }
      if (shows.size() == covered.size() || static_cast<int>(shows.size()) < kLeastBackgrounds) continue;
      std::array<uint8_t, 3> median{};
      for (int c = 0; c < 3; ++c) {
        values.clear();
        for (const size_t k : shows) values.push_back(station.images[k].Pixel(x, static_cast<int>(y))[c]);
        median[c] = UpperMedian(values);
      }
      const auto difference = [&](size_t k) {
        return MostDifferentChannel(station.images[k].Pixel(x, static_cast<int>(y)), median.data());
      };
      differences.clear();
      for (const size_t k : shows) differences.push_back(difference(k));
      const BackgroundRange range = FindBackgroundRange(&differences);
      for (size_t k = 0; k < covered.size(); ++k) {
        if (covered[k][at] == 0) continue;
        votes[k].pixels[at] = difference(k) > range.most ? Pixel::kDiffers : Pixel::kSame;
        votes[k].chances[at] = static_cast<float>(range.chance);
      }
    }
  });
  return votes;
}

}  // namespace

std::vector<uint32_t> FindShowingBackground(const std::vector<StationPhotos>& stations,
                                            const std::vector<std::vector<PixelMask>>& masks,
                                            const Placement& gaussians) {
  std::vector<std::vector<PhotoVotes>> of_stations;
  of_stations.reserve(stations.size());
  for (size_t s = 0; s < stations.size(); ++s) of_stations.push_back(VotesOf(stations[s], masks[s]));
  std::vector<BackgroundVotes> votes(gaussians.size());
  ParallelFor(static_cast<int64_t>(votes.size()), 0, kGaussiansAtOnce, [&](int64_t i) {
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
        const Pixel shown = of_stations[s][k].pixels[at];
        if (shown == Pixel::kUnknown) continue;
        ++votes[i].photos;
        votes[i].differ += shown == Pixel::kDiffers ? 1 : 0;
        votes[i].chance += of_stations[s][k].chances[at];
      }
    }
  });
  BackgroundVotes sum;
  int asked = 0;
  for (const BackgroundVotes& of : votes) {
    sum.photos += of.photos;
    sum.differ += of.differ;
    asked += of.photos > 0 ? 1 : 0;
  }
  const double as_thing = ShareWhereSomethingIs(sum);
  std::vector<uint32_t> showing;
  for (size_t i = 0; i < votes.size(); ++i) {
    if (Weigh(votes[i], as_thing, asked) == BackgroundSight::kNotThere)
      showing.push_back(static_cast<uint32_t>(i));
  }
  return showing;
}

}  // namespace s2gs
