#include "sfm_split/split/still_keypoints.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>

#include "sfm_split/base/parallel_for.h"
#include "sfm_split/matching/keypoint_grid.h"

namespace s2gs {
namespace {

constexpr int kMaxPartners = 32;  // photos of the station, evenly chosen, in which a keypoint is looked for
constexpr float kCellPx = 4;      // of the grid in which a place's keypoints are found
// Cosine of the largest angle between descriptors of one still point. Descriptors of chance keypoints at one
// place differ by about 1 radian.
constexpr double kMinCosine = 0.88;

int32_t Dot(const uint8_t* a, const uint8_t* b) {
  int32_t sum = 0;
  for (int i = 0; i < kDescriptorSize; ++i) sum += static_cast<int32_t>(a[i]) * b[i];
  return sum;
}

}  // namespace

StillSupport FindStillSupport(const std::vector<SplitImage>& images, const Stations& stations,
                              double max_unmoved_px) {
  const auto radius = static_cast<float>(max_unmoved_px);
  StillSupport result;
  result.support.resize(images.size());
  result.num_partners.assign(images.size(), 0);
  std::vector<std::vector<float>> norms(images.size());
  std::vector<KeypointGrid> grids;
  grids.reserve(images.size());
  for (size_t i = 0; i < images.size(); ++i) {
    result.support[i].assign(images[i].keypoints.size(), 0);
    grids.emplace_back(images[i].keypoints, kCellPx);
    norms[i].reserve(images[i].keypoints.size());
    for (size_t k = 0; k < images[i].keypoints.size(); ++k) {
      const uint8_t* descriptor = images[i].descriptors.data() + k * kDescriptorSize;
      norms[i].push_back(std::sqrt(static_cast<float>(Dot(descriptor, descriptor))));
    }
  }

  ParallelFor(static_cast<int64_t>(images.size()), 0, [&](int64_t i) {
    const std::vector<int>& station = stations.images[stations.station_of_image[i]];
    const auto num = static_cast<int>(station.size());
    const auto place =
        static_cast<int>(std::find(station.begin(), station.end(), static_cast<int>(i)) - station.begin());
    const int num_partners = std::min(num - 1, kMaxPartners);
    result.num_partners[i] = num_partners;
    for (int p = 0; p < num_partners; ++p) {
      const int offset = 1 + static_cast<int>((static_cast<int64_t>(p) * (num - 1)) / num_partners);
      const int j = station[(place + offset) % num];
      for (size_t k = 0; k < images[i].keypoints.size(); ++k) {
        const Eigen::Vector2f xy = stations.Move(static_cast<int>(i), j, images[i].keypoints[k]);
        const uint8_t* descriptor = images[i].descriptors.data() + k * kDescriptorSize;
        bool is_still = false;
        grids[j].ForEachWithin(xy, radius, [&](uint32_t other, float /*squared*/) {
          if (is_still) return;
          const int32_t dot = Dot(descriptor, images[j].descriptors.data() + size_t{other} * kDescriptorSize);
          is_still = static_cast<double>(dot) >=
                     kMinCosine * static_cast<double>(norms[i][k]) * static_cast<double>(norms[j][other]);
        });
        result.support[i][k] += is_still ? 1 : 0;
      }
    }
  });
  return result;
}

}  // namespace s2gs
