#include "sfm_split/unmoved_keypoints.h"

#include <cmath>
#include <limits>
#include <map>
#include <utility>

#include "sfm_split/keypoint_grid.h"
#include "sfm_split/statistics.h"

namespace s2gs {
namespace {

using Cell = std::pair<int, int>;

Eigen::Vector2f CommonShift(const Keypoints& keypoints, const std::vector<uint32_t>& chosen,
                            const Keypoints& others, const std::vector<bool>& usable, float max_shake_px) {
  const KeypointGrid grid(others, max_shake_px, usable);
  std::map<Cell, std::vector<Eigen::Vector2f>> displacements;
  for (const uint32_t k : chosen) {
    grid.ForEachWithin(keypoints[k], max_shake_px, [&](uint32_t other, float /*squared*/) {
      const Eigen::Vector2f d = others[other] - keypoints[k];
      displacements[{static_cast<int>(std::lround(d.x())), static_cast<int>(std::lround(d.y()))}].push_back(
          d);
    });
  }
  const std::vector<Eigen::Vector2f>* most = nullptr;
  for (const auto& [cell, all] : displacements) {
    if (most == nullptr || all.size() > most->size()) most = &all;
  }
  if (most == nullptr) return Eigen::Vector2f::Zero();
  std::vector<float> x;
  std::vector<float> y;
  for (const Eigen::Vector2f& d : *most) {
    x.push_back(d.x());
    y.push_back(d.y());
  }
  return {UpperMedian(x), UpperMedian(y)};
}

}  // namespace

std::vector<uint32_t> FindUnmovedKeypoints(const Keypoints& keypoints, const std::vector<uint32_t>& chosen,
                                           const Keypoints& others, const std::vector<bool>& usable,
                                           float max_shake_px, float max_distance_px) {
  const Eigen::Vector2f shift = CommonShift(keypoints, chosen, others, usable, max_shake_px);
  const KeypointGrid grid(others, max_distance_px, usable);
  std::vector<uint32_t> found;
  found.reserve(chosen.size());
  for (const uint32_t k : chosen) {
    float best = std::numeric_limits<float>::infinity();
    uint32_t nearest = kNoKeypoint;
    grid.ForEachWithin(keypoints[k] + shift, max_distance_px, [&](uint32_t other, float squared) {
      if (squared > best || (squared == best && other >= nearest)) return;
      best = squared;
      nearest = other;
    });
    found.push_back(nearest);
  }
  return found;
}

}  // namespace s2gs
