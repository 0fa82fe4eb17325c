#include "s2gs/scene/photo_exposure.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <map>
#include <tuple>
#include <utility>

#include "s2gs/image/median_picture.h"
#include "s2gs/image/photos.h"
#include "sfm_split/base/median_of_pictures.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

constexpr int kSmallSide = 160;   // [px], of the pictures that are compared
constexpr uint8_t kDark = 10;     // [grey levels]: below, rounding is more than a twentieth.
constexpr uint8_t kBright = 245;  // [grey levels]: what saturates says nothing.
constexpr size_t kLeastPixels = 400;
constexpr double kMostScatter = 0.1;  // of the ratios, relative: more than noise: half of the picture turns.
constexpr double kGreyLevel = 1.0 / 255;  // relative, of the brightest: less is not seen.
constexpr int kEqualisingRounds = 3;      // the median's own exposure changes with what is taken off.

using LogGains = std::array<double, 3>;

Image8 Divided(const Image8& image, const LogGains& gains) {
  std::array<std::array<uint8_t, 256>, 3> table;
  for (size_t c = 0; c < 3; ++c) {
    for (int v = 0; v < 256; ++v) {
      table[c][static_cast<size_t>(v)] =
          static_cast<uint8_t>(std::clamp(std::lround(v * std::exp(-gains[c])), 0L, 255L));
    }
  }
  Image8 divided = image;
  for (size_t i = 0; i < divided.pixels.size(); ++i) divided.pixels[i] = table[i % 3][divided.pixels[i]];
  return divided;
}

// Of a photo over a picture of the same size. False where the pixels do not agree on one.
bool FindGains(const Image8& photo, const Image8& still, LogGains* gains) {
  for (size_t c = 0; c < 3; ++c) {
    std::vector<double> ratios;
    for (size_t i = c; i < photo.pixels.size(); i += 3) {
      const uint8_t a = photo.pixels[i];
      const uint8_t b = still.pixels[i];
      if (std::min(a, b) > kDark && std::max(a, b) < kBright)
        ratios.push_back(std::log(static_cast<double>(a) / b));
    }
    if (ratios.size() < kLeastPixels) return false;
    (*gains)[c] = UpperMedian(ratios);
    for (double& ratio : ratios) ratio = std::abs(ratio - (*gains)[c]);
    if (kSigmaOfMad * UpperMedian(std::move(ratios)) > kMostScatter) return false;
  }
  return true;
}

// Of a camera's photos. Empty where they do not tell.
std::vector<LogGains> GainsOf(const std::vector<const Image8*>& photos) {
  std::vector<Image8> pictures(photos.size());
  ParallelFor(static_cast<int64_t>(photos.size()), 0, [&](int64_t i) {
    pictures[static_cast<size_t>(i)] = ExposurePicture(*photos[static_cast<size_t>(i)]);
  });
  std::vector<LogGains> gains(photos.size(), LogGains{});
  for (int round = 0; round < kEqualisingRounds; ++round) {
    std::vector<Image8> equal(pictures.size());
    ParallelFor(static_cast<int64_t>(pictures.size()), 0, [&](int64_t k) {
      const auto i = static_cast<size_t>(k);
      equal[i] = Divided(pictures[i], gains[i]);
    });
    const Image8 still = MedianPicture(equal);
    std::vector<char> agrees(pictures.size());
    ParallelFor(static_cast<int64_t>(pictures.size()), 0, [&](int64_t k) {
      const auto i = static_cast<size_t>(k);
      agrees[i] = FindGains(pictures[i], still, &gains[i]) ? 1 : 0;
    });
    if (std::find(agrees.begin(), agrees.end(), 0) != agrees.end()) return {};
    LogGains mean = {};
    for (size_t i = 0; i < pictures.size(); ++i) {
      for (size_t c = 0; c < 3; ++c) mean[c] += gains[i][c] / static_cast<double>(pictures.size());
    }
    for (LogGains& of_photo : gains) {
      for (size_t c = 0; c < 3; ++c) of_photo[c] -= mean[c];
    }
  }
  return gains;
}

// The gains that were taken off a camera's photos. Empty where nothing was.
std::vector<LogGains> EqualiseCamera(const std::vector<Image8*>& photos) {
  std::vector<LogGains> gains = LogExposureGains({photos.begin(), photos.end()});
  ParallelFor(static_cast<int64_t>(gains.size()), 0, [&](int64_t i) {
    Image8& photo = *photos[static_cast<size_t>(i)];
    photo = Divided(photo, gains[static_cast<size_t>(i)]);
  });
  return gains;
}

}  // namespace

Image8 ExposurePicture(const Image8& photo) {
  const double scale = std::min(1.0, static_cast<double>(kSmallSide) / std::max(photo.width, photo.height));
  return ResizeByArea(photo, std::max(1, static_cast<int>(photo.width * scale)),
                      std::max(1, static_cast<int>(photo.height * scale)));
}

std::vector<std::array<double, 3>> LogExposureGains(const std::vector<const Image8*>& photos) {
  if (photos.size() < kPicturesForMedian) return {};
  std::vector<LogGains> gains = GainsOf(photos);
  double most = 0;
  for (const LogGains& of_photo : gains) {
    for (const double gain : of_photo) most = std::max(most, std::abs(gain));
  }
  return most > kGreyLevel ? gains : std::vector<LogGains>();
}

ExposureSpread EqualiseExposure(std::vector<ScenePhoto>* photos) {
  std::map<std::tuple<int, int, int>, std::vector<Image8*>> by_camera;
  for (ScenePhoto& photo : *photos) {
    if (!photo.image.pixels.empty())
      by_camera[{photo.station, photo.image.width, photo.image.height}].push_back(&photo.image);
  }
  ExposureSpread spread;
  for (const auto& entry : by_camera) {
    const std::vector<LogGains> gains = EqualiseCamera(entry.second);
    spread.num_photos += static_cast<int>(gains.size());
    for (const LogGains& of_photo : gains) {
      for (const double gain : of_photo) {
        spread.least = std::min(spread.least, std::exp(gain));
        spread.greatest = std::max(spread.greatest, std::exp(gain));
      }
    }
  }
  return spread;
}

bool EqualiseExposure(std::vector<Image8>* photos) {
  std::vector<Image8*> of_camera;
  for (Image8& photo : *photos) of_camera.push_back(&photo);
  return !EqualiseCamera(of_camera).empty();
}

}  // namespace s2gs
