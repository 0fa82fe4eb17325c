#include "sfm_split/adjust/points_apart.h"

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/rigid3.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

using Eigen::Vector3d;

constexpr size_t kLeastKnown = 20;   // a judgement: points that tell a density, some in each octant.
constexpr size_t kMostKnown = 2000;  // more tell no more of it, and cost time.
// Widths that are tried, from a quarter of the distance between neighbours to the body's size.
constexpr int kNumWidths = 16;
constexpr int kMaxRounds = 100;      // of expectation and maximisation
constexpr double kSameShare = 1e-6;  // of points that are right, from round to round: it is settled

// Falls with the sixth power: a point some widths away is none of the body's where the next is a width away,
// and is where all of its neighbours are as far.
double Kernel(double squared_distance, double width) {
  const double ratio = 1 + squared_distance / (width * width);
  return 4 / (kPi * kPi * width * width * width) / (ratio * ratio * ratio);
}

class BodyDensity {
 public:
  explicit BodyDensity(const std::vector<Vector3d>& points) {
    const size_t stride = (points.size() + kMostKnown - 1) / kMostKnown;
    for (size_t p = 0; p < points.size(); p += stride) points_.push_back(points[p]);
    FindWidth();
  }

  double At(const Vector3d& x) const {
    double sum = 0;
    for (const Vector3d& point : points_) sum += Kernel((point - x).squaredNorm(), width_);
    return sum / static_cast<double>(points_.size());
  }

 private:
  void FindWidth() {
    const auto n = static_cast<int64_t>(points_.size());
    std::vector<double> nearest(points_.size());
    std::vector<double> farthest(points_.size());
    ParallelFor(n, 0, [&](int64_t i) {
      double least = std::numeric_limits<double>::infinity();
      double most = 0;
      for (int64_t j = 0; j < n; ++j) {
        if (i == j) continue;
        const double squared = (points_[i] - points_[j]).squaredNorm();
        if (squared > 0) least = std::min(least, squared);
        most = std::max(most, squared);
      }
      nearest[i] = std::sqrt(least);
      farthest[i] = std::sqrt(most);
    });
    const double first = UpperMedian(nearest) / 4;
    const double last = UpperMedian(farthest);
    width_ = last;
    if (!(first > 0 && first < last)) return;
    double best = -std::numeric_limits<double>::infinity();
    for (int k = 0; k < kNumWidths; ++k) {
      const double width = first * std::pow(last / first, static_cast<double>(k) / (kNumWidths - 1));
      std::vector<double> foretold(points_.size());
      ParallelFor(n, 0, [&](int64_t i) {
        double sum = 0;
        for (int64_t j = 0; j < n; ++j)
          if (i != j) sum += Kernel((points_[i] - points_[j]).squaredNorm(), width);
        foretold[i] = std::log(sum / static_cast<double>(n - 1));
      });
      double likelihood = 0;
      for (const double of_point : foretold) likelihood += of_point;
      if (likelihood > best) {
        best = likelihood;
        width_ = width;
      }
    }
  }

  std::vector<Vector3d> points_;
  double width_ = 0;
};

// The density there of points whose first keypoint lies anywhere in its photo, and the second anywhere on the
// epipolar line in its own.
std::optional<double> DensityOfWrong(const PosedImage& first, const PosedImage& second, const Vector3d& x) {
  Eigen::Vector2d xy;
  Eigen::Matrix<double, 2, 3> by_first;
  Eigen::Matrix<double, 2, 3> by_second;
  if (!ProjectPoint(first, x, &xy, &by_first) || !ProjectPoint(second, x, &xy, &by_second))
    return std::nullopt;
  const Vector3d ray = (x - CameraCentre(first.cam_from_body)).normalized();
  const double across = std::sqrt((by_first * by_first.transpose()).determinant());
  const double along = (by_second * ray).norm();
  const auto area = [](const Camera& camera) {
    return static_cast<double>(camera.width) * static_cast<double>(camera.height);
  };
  return across / area(*first.camera) * along / std::sqrt(area(*second.camera));
}

}  // namespace

std::vector<bool> PointsApart(const std::vector<PosedImage>& images, const std::vector<TrackPoint>& points) {
  std::vector<bool> apart(points.size(), false);
  std::vector<Vector3d> known;
  std::vector<size_t> asked;
  std::vector<double> wrong;
  for (size_t p = 0; p < points.size(); ++p) {
    const std::vector<TrackElement>& track = points[p].track;
    if (track.size() > 2) {
      known.push_back(points[p].x_in_body);
      continue;
    }
    const std::optional<double> density =
        DensityOfWrong(images[static_cast<size_t>(track[0].image)],
                       images[static_cast<size_t>(track[1].image)], points[p].x_in_body);
    if (!density) continue;
    asked.push_back(p);
    wrong.push_back(*density);
  }
  if (known.size() < kLeastKnown || asked.empty()) return apart;
  const BodyDensity body(known);
  std::vector<double> right(asked.size());
  ParallelFor(static_cast<int64_t>(asked.size()), 0,
              [&](int64_t k) { right[k] = body.At(points[asked[k]].x_in_body); });
  double share = 0.5;
  std::vector<double> is_right(asked.size());
  for (int round = 0; round < kMaxRounds; ++round) {
    double sum = 0;
    for (size_t k = 0; k < asked.size(); ++k) {
      is_right[k] = share * right[k] / (share * right[k] + (1 - share) * wrong[k]);
      sum += is_right[k];
    }
    const double before = share;
    share = sum / static_cast<double>(asked.size());
    if (std::abs(share - before) < kSameShare) break;
  }
  for (size_t k = 0; k < asked.size(); ++k) apart[asked[k]] = is_right[k] < 0.5;
  return apart;
}

}  // namespace s2gs
