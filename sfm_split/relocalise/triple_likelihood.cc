#include "sfm_split/relocalise/triple_likelihood.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "sfm_split/adjust/posed_images.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/circular_motion/match_mixture.h"
#include "sfm_split/scene/camera_model.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

// The middle of three keypoints is one noise, the point that the outer ones tell there half of their two.
constexpr double kNoiseOfMiddle = 1.2247448713915890;  // the square root of 1 + 1/2

// Where two rays are nearest to each other, in the body; nothing where they are parallel or meet behind.
std::optional<Vector3d> Meet(const PosedImage& a, const Vector2d& xy_a, const PosedImage& b,
                             const Vector2d& xy_b) {
  const std::optional<Vector3d> in_a = UnprojectFromImage(*a.camera, xy_a);
  const std::optional<Vector3d> in_b = UnprojectFromImage(*b.camera, xy_b);
  if (!in_a || !in_b) return std::nullopt;
  const Vector3d centre_a = CameraCentre(a.cam_from_body);
  const Vector3d centre_b = CameraCentre(b.cam_from_body);
  const Vector3d ray_a = (a.cam_from_body.rotation.conjugate() * *in_a).normalized();
  const Vector3d ray_b = (b.cam_from_body.rotation.conjugate() * *in_b).normalized();
  const double cosine = ray_a.dot(ray_b);
  const double squared_sine = 1 - cosine * cosine;
  if (!(squared_sine > 1e-12)) return std::nullopt;
  const Vector3d between = centre_b - centre_a;
  const double along_a = (ray_a.dot(between) - cosine * ray_b.dot(between)) / squared_sine;
  const double along_b = (cosine * ray_a.dot(between) - ray_b.dot(between)) / squared_sine;
  if (!(along_a > 0 && along_b > 0)) return std::nullopt;
  return 0.5 * (centre_a + along_a * ray_a + centre_b + along_b * ray_b);
}

// Photos of each station, in the features' order.
std::map<int, std::vector<size_t>> PhotosOfStations(const ScanFeatures& features) {
  std::map<int, std::vector<size_t>> photos;
  for (size_t i = 0; i < features.images.size(); ++i) photos[features.images[i].station].push_back(i);
  return photos;
}

}  // namespace

double GainOfTriples(const ScanFeatures& features, const AlignedScene& aligned, double sigma_px) {
  const std::vector<PosedImage> posed = PosedImages(features, aligned.scene, true);
  std::map<std::pair<int, int>, FeatureMatches> matches_of;
  KeypointExtent extent;
  for (const ImagePairMatches& pair : AllPairs(features)) {
    FeatureMatches matches = PossibleObjectMatches(features, pair);
    const bool is_in_order = pair.image1 < pair.image2;
    for (FeatureMatch& match : matches) {
      extent.Add(
          features.images[static_cast<size_t>(pair.image1)].keypoints[match.point2D_idx1].cast<double>());
      if (!is_in_order) std::swap(match.point2D_idx1, match.point2D_idx2);
    }
    matches_of[std::minmax(pair.image1, pair.image2)] = std::move(matches);
  }
  const double noise = kNoiseOfMiddle * sigma_px;
  const double peak = 1 / (noise * kRootTwoPi);
  double gain = 0;
  for (const auto& [station, photos] : PhotosOfStations(features)) {
    for (size_t p = 1; p + 1 < photos.size(); ++p) {
      const size_t before = photos[p - 1];
      const size_t middle = photos[p];
      const size_t after = photos[p + 1];
      if (!posed[before].is_posed || !posed[middle].is_posed || !posed[after].is_posed) continue;
      const auto first = matches_of.find({static_cast<int>(before), static_cast<int>(middle)});
      const auto second = matches_of.find({static_cast<int>(middle), static_cast<int>(after)});
      if (first == matches_of.end() || second == matches_of.end()) continue;
      std::map<uint32_t, uint32_t> next;
      for (const FeatureMatch& match : second->second) next.emplace(match.point2D_idx1, match.point2D_idx2);
      std::vector<double> over;  // density of a right one's error over that of a wrong one's
      for (const FeatureMatch& match : first->second) {
        const auto found = next.find(match.point2D_idx2);
        if (found == next.end()) continue;
        const Vector2d a = features.images[before].keypoints[match.point2D_idx1].cast<double>();
        const Vector2d b = features.images[middle].keypoints[match.point2D_idx2].cast<double>();
        const Vector2d c = features.images[after].keypoints[found->second].cast<double>();
        over.push_back(0);
        const Vector2d move = c - a;
        const std::optional<Vector3d> x = Meet(posed[before], a, posed[after], c);
        if (!x || !(move.norm() > 0)) continue;
        const std::optional<Vector2d> seen =
            ProjectToImage(*posed[middle].camera, posed[middle].cam_from_body * *x);
        if (!seen) continue;
        const double ratio = move.normalized().dot(*seen - b) / noise;
        over.back() = peak * extent.Px() * std::exp(-0.5 * ratio * ratio);
      }
      if (!over.empty()) gain += MixtureGain(over, RightShare(over));
    }
  }
  return gain;
}

double StepsTurnedOtherwise(const ScanFeatures& features, const AlignedScene& one,
                            const AlignedScene& other) {
  std::map<std::string, double> angle_of[2];
  for (const View& view : one.scene.views) angle_of[0][view.name] = view.angle_deg * kDegree;
  for (const View& view : other.scene.views) angle_of[1][view.name] = view.angle_deg * kDegree;
  double most = 0;
  for (const auto& [station, photos] : PhotosOfStations(features)) {
    std::vector<double> steps;
    double turned[2] = {0, 0};
    std::optional<std::pair<double, double>> before;
    for (const size_t photo : photos) {
      const auto first = angle_of[0].find(features.images[photo].name);
      const auto second = angle_of[1].find(features.images[photo].name);
      if (first == angle_of[0].end() || second == angle_of[1].end()) continue;
      if (before) {
        turned[0] += WrapAngle(first->second - before->first);
        turned[1] += WrapAngle(second->second - before->second);
        steps.push_back(std::abs(WrapAngle(first->second - before->first)));
      }
      before = {first->second, second->second};
    }
    if (steps.empty()) continue;
    const double step = std::max(UpperMedian(std::move(steps)), 1e-9);
    most = std::max(most, std::abs(std::abs(turned[0]) - std::abs(turned[1])) / step);
  }
  return most;
}

}  // namespace s2gs
