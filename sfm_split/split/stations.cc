#include "sfm_split/split/stations.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <bitset>
#include <cmath>
#include <numeric>
#include <string>
#include <utility>

#include "sfm_split/base/number_text.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

constexpr int kGridSize = 8;  // cells along each side of a photo, that say how far the background spreads
constexpr double kReferenceSidePx = 1600;  // photos up to this size have the options' bounds
constexpr double kMaxShakePx = 100;        // the option's own bound
using Box2f = Eigen::AlignedBox<float, 2>;

// The densest 3 x 3 px neighbourhood of the displacements that shake can explain.
Eigen::Vector2f CommonShift(const std::vector<Eigen::Vector2f>& displacements, double max_shake_px) {
  const int radius = static_cast<int>(std::ceil(max_shake_px)) + 1;
  const int side = 2 * radius + 1;
  std::vector<int> histogram(static_cast<size_t>(side) * side, 0);
  for (const Eigen::Vector2f& d : displacements) {
    if (std::abs(d.x()) > max_shake_px || std::abs(d.y()) > max_shake_px) continue;
    const int x = static_cast<int>(std::lround(d.x())) + radius;
    const int y = static_cast<int>(std::lround(d.y())) + radius;
    ++histogram[static_cast<size_t>(y) * side + x];
  }
  int best_count = 0;
  Eigen::Vector2f best = Eigen::Vector2f::Zero();
  for (int y = 1; y + 1 < side; ++y) {
    for (int x = 1; x + 1 < side; ++x) {
      int count = 0;
      for (int dy = -1; dy <= 1; ++dy) {
        for (int dx = -1; dx <= 1; ++dx) count += histogram[static_cast<size_t>(y + dy) * side + x + dx];
      }
      if (count > best_count) {
        best_count = count;
        best = Eigen::Vector2f(static_cast<float>(x - radius), static_cast<float>(y - radius));
      }
    }
  }
  return best;
}

// Union-find that carries each image's shift relative to its group's root, so that a join which would spread
// a group's shifts beyond what shake explains can be refused.
class ShiftedGroups {
 public:
  explicit ShiftedGroups(size_t count) : parent_(count), shift_(count, Eigen::Vector2f::Zero()), box_(count) {
    std::iota(parent_.begin(), parent_.end(), 0);
    for (auto& box : box_) box = Box2f(Eigen::Vector2f(Eigen::Vector2f::Zero()));
  }

  int Root(int image) const {
    while (parent_[image] != image) image = parent_[image];
    return image;
  }
  Eigen::Vector2f ShiftFromRoot(int image) const {
    Eigen::Vector2f total = Eigen::Vector2f::Zero();
    for (; parent_[image] != image; image = parent_[image]) total += shift_[image];
    return total;
  }

  void Join(int image1, int image2, const Eigen::Vector2f& shift_1_to_2, float max_spread) {
    const int root1 = Root(image1);
    const int root2 = Root(image2);
    if (root1 == root2) return;
    const Eigen::Vector2f root2_from_root1 = ShiftFromRoot(image1) + shift_1_to_2 - ShiftFromRoot(image2);
    Box2f moved = box_[root2];
    moved.translate(root2_from_root1);
    const Box2f joined = box_[root1].merged(moved);
    if (joined.sizes().maxCoeff() > max_spread) return;
    parent_[root2] = root1;
    shift_[root2] = root2_from_root1;
    box_[root1] = joined;
  }

 private:
  std::vector<int> parent_;
  std::vector<Eigen::Vector2f> shift_;  // relative to the parent
  std::vector<Box2f> box_;              // of the group's shifts, valid at roots
};

}  // namespace

OptionCheck StationOptions::Check() const {
  if (!(max_unmoved_px > 0)) return OptionFault{"max_unmoved_px", NumberText(max_unmoved_px), "> 0"};
  if (!(max_shake_px >= 0 && max_shake_px <= kMaxShakePx)) {
    return OptionFault{"max_shake_px", NumberText(max_shake_px), "0 <= max_shake_px <= 100"};
  }
  if (min_unmoved_matches < 4) {
    return OptionFault{"min_unmoved_matches", std::to_string(min_unmoved_matches), ">= 4"};
  }
  if (!(min_unmoved_share >= 0 && min_unmoved_share <= 1)) {
    return OptionFault{"min_unmoved_share", NumberText(min_unmoved_share), "0 <= min_unmoved_share <= 1"};
  }
  if (min_cells < 1 || min_cells > kGridSize * kGridSize) {
    return OptionFault{"min_cells", std::to_string(min_cells), "1 <= min_cells <= 64"};
  }
  return std::nullopt;
}

StationOptions StationOptions::ForPhotosOf(int longest_side_px) const {
  const double scale = std::max(1.0, longest_side_px / kReferenceSidePx);
  StationOptions scaled = *this;
  scaled.max_unmoved_px *= scale;
  scaled.max_shake_px = std::min(scaled.max_shake_px * scale, kMaxShakePx);
  return scaled;
}

UnmovedMatches FindUnmovedMatches(const Keypoints& keypoints1, const Keypoints& keypoints2,
                                  const ImagePairMatches& pair, const Eigen::Vector2i& image_size,
                                  const StationOptions& options) {
  UnmovedMatches result;
  result.is_unmoved.assign(pair.matches.size(), false);
  if (pair.matches.empty()) return result;

  std::vector<Eigen::Vector2f> displacements;
  displacements.reserve(pair.matches.size());
  for (const FeatureMatch& match : pair.matches) {
    displacements.emplace_back(keypoints2[match.point2D_idx2] - keypoints1[match.point2D_idx1]);
  }

  result.shift = CommonShift(displacements, options.max_shake_px);
  const auto max_unmoved = static_cast<float>(options.max_unmoved_px);
  // The mode is known to a pixel; the median of what follows it, to a small part of one.
  std::vector<float> xs;
  std::vector<float> ys;
  for (const Eigen::Vector2f& d : displacements) {
    if ((d - result.shift).norm() > max_unmoved + 0.5F) continue;
    xs.push_back(d.x());
    ys.push_back(d.y());
  }
  if (xs.empty()) return result;
  result.shift = Eigen::Vector2f(UpperMedian(std::move(xs)), UpperMedian(std::move(ys)));

  std::bitset<kGridSize * kGridSize> cells;
  for (size_t m = 0; m < displacements.size(); ++m) {
    if ((displacements[m] - result.shift).norm() > max_unmoved) continue;
    result.is_unmoved[m] = true;
    ++result.num_unmoved;
    const Eigen::Vector2f& xy = keypoints1[pair.matches[m].point2D_idx1];
    const int cx = std::clamp(static_cast<int>(xy.x() * kGridSize / image_size.x()), 0, kGridSize - 1);
    const int cy = std::clamp(static_cast<int>(xy.y() * kGridSize / image_size.y()), 0, kGridSize - 1);
    cells.set(static_cast<size_t>(cy) * kGridSize + cx);
  }
  result.num_cells = static_cast<int>(cells.count());
  result.same_station =
      result.num_unmoved >= options.min_unmoved_matches &&
      result.num_unmoved >= options.min_unmoved_share * static_cast<double>(pair.matches.size()) &&
      result.num_cells >= options.min_cells;
  return result;
}

Eigen::Matrix3d Stations::PhotoFromFirst(int image) const {
  constexpr double kRounding = 1e-12;  // of maps that were taken from the pictures' pixels to the photos'
  if (photo_from_first.empty() || photo_from_first[image].isApprox(Eigen::Matrix3d::Identity(), kRounding))
    return Eigen::Matrix3d::Identity();
  return photo_from_first[image];
}

Eigen::Vector2f Stations::Move(int from, int to, const Eigen::Vector2f& xy) const {
  if (photo_from_first.empty()) return xy + (shift[to] - shift[from]);
  const Eigen::Vector3d first = photo_from_first[from].inverse() * xy.cast<double>().homogeneous();
  return (photo_from_first[to] * first).hnormalized().cast<float>();
}

std::vector<StationJoin> FindStationJoins(const std::vector<Keypoints>& keypoints,
                                          const std::vector<Eigen::Vector2i>& image_sizes,
                                          const std::vector<ImagePairMatches>& pairs,
                                          const StationOptions& options) {
  std::vector<StationJoin> joins;
  for (const ImagePairMatches& pair : pairs) {
    const UnmovedMatches unmoved = FindUnmovedMatches(keypoints[pair.image1], keypoints[pair.image2], pair,
                                                      image_sizes[pair.image1], options);
    if (unmoved.same_station) joins.push_back({pair.image1, pair.image2, unmoved.num_unmoved, unmoved.shift});
  }
  std::stable_sort(joins.begin(), joins.end(),
                   [](const StationJoin& a, const StationJoin& b) { return a.num_unmoved > b.num_unmoved; });
  return joins;
}

Stations GroupJoined(size_t num_images, const std::vector<StationJoin>& joins,
                     const StationOptions& options) {
  ShiftedGroups groups(num_images);
  for (const StationJoin& join : joins) {
    groups.Join(join.image1, join.image2, join.shift, static_cast<float>(options.max_shake_px));
  }

  Stations stations;
  stations.station_of_image.assign(num_images, -1);
  stations.shift.resize(num_images);
  std::vector<int> station_of_root(num_images, -1);
  for (int image = 0; image < static_cast<int>(num_images); ++image) {
    int& station = station_of_root[groups.Root(image)];
    if (station < 0) {
      station = static_cast<int>(stations.images.size());
      stations.images.emplace_back();
    }
    stations.station_of_image[image] = station;
    stations.images[station].push_back(image);
    stations.shift[image] =
        groups.ShiftFromRoot(image) - groups.ShiftFromRoot(stations.images[station].front());
  }
  return stations;
}

}  // namespace s2gs
