#include "sfm_split/still_keypoints.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>

namespace s2gs {
namespace {

constexpr int kMaxPartners = 32;
constexpr float kCellPx = 4;
// Cosine of the largest angle between descriptors of one still point. Descriptors of chance keypoints at one
// place differ by about 1 radian.
constexpr double kMinCosine = 0.88;

// Keypoints sorted by cells of kCellPx.
class KeypointGrid {
 public:
  explicit KeypointGrid(const SplitImage& image)
      : columns_(static_cast<int>(static_cast<float>(image.size.x()) / kCellPx) + 1),
        rows_(static_cast<int>(static_cast<float>(image.size.y()) / kCellPx) + 1) {
    std::vector<uint32_t> cell(image.keypoints.size());
    begin_.assign(static_cast<size_t>(columns_) * rows_ + 1, 0);
    for (size_t k = 0; k < cell.size(); ++k) {
      cell[k] =
          static_cast<uint32_t>(Row(image.keypoints[k].y()) * columns_ + Column(image.keypoints[k].x()));
      ++begin_[cell[k] + 1];
    }
    for (size_t c = 1; c < begin_.size(); ++c) begin_[c] += begin_[c - 1];
    order_.resize(cell.size());
    std::vector<uint32_t> next(begin_.begin(), begin_.end() - 1);
    for (uint32_t k = 0; k < cell.size(); ++k) order_[next[cell[k]]++] = k;
  }

  // Calls visit(keypoint) for all in the cells that a square of +- radius around xy touches.
  template <typename Visit>
  void ForEachNear(const Eigen::Vector2f& xy, float radius, const Visit& visit) const {
    for (int r = Row(xy.y() - radius); r <= Row(xy.y() + radius); ++r) {
      for (int c = Column(xy.x() - radius); c <= Column(xy.x() + radius); ++c) {
        const size_t cell = static_cast<size_t>(r) * columns_ + c;
        for (uint32_t o = begin_[cell]; o < begin_[cell + 1]; ++o) visit(order_[o]);
      }
    }
  }

 private:
  static int Clamped(float value, int count) {
    const float cell = std::floor(value / kCellPx);
    return cell > 0 ? static_cast<int>(std::min(cell, static_cast<float>(count - 1))) : 0;
  }
  int Column(float x) const { return Clamped(x, columns_); }
  int Row(float y) const { return Clamped(y, rows_); }

  int columns_;
  int rows_;
  std::vector<uint32_t> begin_;
  std::vector<uint32_t> order_;
};

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
    grids.emplace_back(images[i]);
    norms[i].reserve(images[i].keypoints.size());
    for (size_t k = 0; k < images[i].keypoints.size(); ++k) {
      const uint8_t* descriptor = images[i].descriptors.data() + k * kDescriptorSize;
      norms[i].push_back(std::sqrt(static_cast<float>(Dot(descriptor, descriptor))));
    }
  }

#pragma omp parallel for schedule(dynamic)
  for (size_t i = 0; i < images.size(); ++i) {
    const std::vector<int>& station = stations.images[stations.station_of_image[i]];
    const auto num = static_cast<int>(station.size());
    const auto place =
        static_cast<int>(std::find(station.begin(), station.end(), static_cast<int>(i)) - station.begin());
    const int num_partners = std::min(num - 1, kMaxPartners);
    result.num_partners[i] = num_partners;
    for (int p = 0; p < num_partners; ++p) {
      const int offset = 1 + static_cast<int>((static_cast<int64_t>(p) * (num - 1)) / num_partners);
      const int j = station[(place + offset) % num];
      const Eigen::Vector2f shift = stations.shift[j] - stations.shift[i];
      for (size_t k = 0; k < images[i].keypoints.size(); ++k) {
        const Eigen::Vector2f xy = images[i].keypoints[k] + shift;
        const uint8_t* descriptor = images[i].descriptors.data() + k * kDescriptorSize;
        bool is_still = false;
        grids[j].ForEachNear(xy, radius, [&](uint32_t other) {
          if (is_still || (images[j].keypoints[other] - xy).norm() > radius) return;
          const int32_t dot = Dot(descriptor, images[j].descriptors.data() + size_t{other} * kDescriptorSize);
          is_still = static_cast<double>(dot) >=
                     kMinCosine * static_cast<double>(norms[i][k]) * static_cast<double>(norms[j][other]);
        });
        result.support[i][k] += is_still ? 1 : 0;
      }
    }
  }
  return result;
}

}  // namespace s2gs
