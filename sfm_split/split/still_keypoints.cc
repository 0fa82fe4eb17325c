#include "sfm_split/split/still_keypoints.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>

#include "sfm_split/base/parallel_for.h"
#include "sfm_split/matching/keypoint_grid.h"

namespace s2gs {
namespace {

constexpr int kMaxPartners = 32;  // photos of the station, evenly chosen, in which a keypoint is looked for
constexpr float kCellPx = 4;      // of the grid in which a place's keypoints are found
// Cosine of the largest angle between descriptors of one still point. Descriptors of chance keypoints at one
// place differ by about 1 radian.
constexpr double kMinCosine = 0.88;
// Where keypoints are looked for that look like one by chance: times the largest distance of an unmoved one.
// A keypoint's own doubles, of other sizes, lie within the inner.
constexpr float kInnerRing = 2;
constexpr float kOuterRing = 4;
constexpr float kRingAreas = kOuterRing * kOuterRing - kInnerRing * kInnerRing;

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
  result.chance.resize(images.size());
  result.lingers.resize(images.size());
  result.num_partners.assign(images.size(), 0);
  std::vector<std::vector<float>> norms(images.size());
  std::vector<KeypointGrid> grids;
  grids.reserve(images.size());
  for (size_t i = 0; i < images.size(); ++i) {
    result.support[i].assign(images[i].keypoints.size(), 0);
    result.chance[i].assign(images[i].keypoints.size(), 0);
    result.lingers[i].assign(images[i].keypoints.size(), false);
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
    std::vector<int> last_shown(images[i].keypoints.size(), 0);  // photos on from its own
    std::vector<int> widest_gap(images[i].keypoints.size(), 0);
    for (int p = 0; p < num_partners; ++p) {
      const int offset = 1 + static_cast<int>((static_cast<int64_t>(p) * (num - 1)) / num_partners);
      const int j = station[(place + offset) % num];
      for (size_t k = 0; k < images[i].keypoints.size(); ++k) {
        const Eigen::Vector2f xy = stations.Move(static_cast<int>(i), j, images[i].keypoints[k]);
        const uint8_t* descriptor = images[i].descriptors.data() + k * kDescriptorSize;
        bool is_still = false;
        grids[j].ForEachWithin(xy, kOuterRing * radius, [&](uint32_t other, float squared) {
          const bool is_here = squared <= radius * radius;
          if (is_here ? is_still : squared <= kInnerRing * kInnerRing * radius * radius) return;
          const int32_t dot = Dot(descriptor, images[j].descriptors.data() + size_t{other} * kDescriptorSize);
          if (static_cast<double>(dot) <
              kMinCosine * static_cast<double>(norms[i][k]) * static_cast<double>(norms[j][other])) {
            return;
          }
          if (is_here) {
            is_still = true;
          } else {
            ++result.chance[i][k];
          }
        });
        if (!is_still) continue;
        ++result.support[i][k];
        widest_gap[k] = std::max(widest_gap[k], offset - last_shown[k]);
        last_shown[k] = offset;
      }
    }
    if (num_partners == 0) return;
    for (size_t k = 0; k < widest_gap.size(); ++k)
      result.lingers[i][k] = 2 * (std::max(widest_gap[k], num - last_shown[k]) - 1) > num;
    // Few photos tell a chance badly: one more of the mean keypoint's is counted.
    std::vector<float>& chance = result.chance[i];
    const auto partners = static_cast<float>(num_partners);
    const float mean = std::accumulate(chance.begin(), chance.end(), 0.0F) /
                       std::max(1.0F, partners * static_cast<float>(chance.size()));
    for (float& of : chance) of = std::min(1.0F, (of + mean) / ((partners + 1) * kRingAreas));
  });
  return result;
}

}  // namespace s2gs
