#include "plugin/outputs/photo_gains.h"

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <map>
#include <tuple>

#include "s2gs/scene/photo_exposure.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {
namespace {

// Of red, green and blue in grey. (ITU-R BT.601)
constexpr std::array<double, 3> kInGrey = {0.299, 0.587, 0.114};

}  // namespace

std::vector<double> GreyGains(const DensePhotos& photos, const std::vector<int>& stations, int num_threads) {
  std::vector<double> gains(stations.size(), 1);
  std::vector<Image8> pictures(stations.size());
  ParallelFor(static_cast<int64_t>(stations.size()), num_threads, [&](int64_t i) {
    if (stations[i] >= 0) pictures[i] = ExposurePicture(photos.Load(static_cast<int>(i), 3));
  });
  std::map<std::tuple<int, int, int>, std::vector<size_t>> by_camera;
  for (size_t i = 0; i < stations.size(); ++i) {
    const ObjectView& view = photos.Camera(static_cast<int>(i));
    if (stations[i] >= 0) by_camera[{stations[i], view.width, view.height}].push_back(i);
  }
  for (const auto& entry : by_camera) {
    std::vector<const Image8*> of_camera;
    for (const size_t i : entry.second) of_camera.push_back(&pictures[i]);
    const std::vector<std::array<double, 3>> logs = LogExposureGains(of_camera);
    for (size_t k = 0; k < logs.size(); ++k) {
      double log = 0;
      for (size_t c = 0; c < 3; ++c) log += kInGrey[c] * logs[k][c];
      gains[entry.second[k]] = std::exp(log);
    }
  }
  return gains;
}

}  // namespace s2gs
