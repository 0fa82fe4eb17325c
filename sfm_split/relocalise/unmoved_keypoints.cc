#include "sfm_split/relocalise/unmoved_keypoints.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <utility>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/matching/keypoint_grid.h"

namespace s2gs {
namespace {

using Cell = std::pair<int, int>;

constexpr double kMaxChance = 1e-2;  // expected number of shifts, up to the one found, that as many share

struct Shift {
  Eigen::Vector2f px = Eigen::Vector2f::Zero();
  double density = 0;  // of pairs of keypoints, whatever their displacement [1 / px^2]
};

Shift CommonShift(const Keypoints& keypoints, const std::vector<uint32_t>& chosen, const Keypoints& others,
                  const std::vector<bool>& usable, float max_shake_px) {
  const KeypointGrid grid(others, max_shake_px, usable);
  std::map<Cell, std::vector<Eigen::Vector2f>> displacements;
  for (const uint32_t k : chosen) {
    grid.ForEachWithin(keypoints[k], max_shake_px, [&](uint32_t other, float /*squared*/) {
      const Eigen::Vector2f d = others[other] - keypoints[k];
      displacements[{static_cast<int>(std::lround(d.x())), static_cast<int>(std::lround(d.y()))}].push_back(
          d);
    });
  }
  Shift shift;
  const std::vector<Eigen::Vector2f>* most = nullptr;
  for (const auto& [cell, all] : displacements) {
    shift.density += static_cast<double>(all.size()) / (kPi * max_shake_px * max_shake_px);
    if (most == nullptr || all.size() > most->size()) most = &all;
  }
  if (most == nullptr) return shift;
  std::vector<float> x;
  std::vector<float> y;
  for (const Eigen::Vector2f& d : *most) {
    x.push_back(d.x());
    y.push_back(d.y());
  }
  shift.px = {UpperMedian(x), UpperMedian(y)};
  return shift;
}

// Of a small shift there are few others that would have been believed before it.
bool IsByChance(const Shift& shift, int shared, float max_distance_px) {
  const double area = kPi * max_distance_px * max_distance_px;
  const double shifts = std::max(1.0, kPi * shift.px.cast<double>().squaredNorm() / area);
  return std::log(shifts) + LogPoissonTail(shared, shift.density * area) > std::log(kMaxChance);
}

}  // namespace

std::vector<uint32_t> FindUnmovedKeypoints(const Keypoints& keypoints, const std::vector<uint32_t>& chosen,
                                           const Keypoints& others, const std::vector<bool>& usable,
                                           float max_shake_px, float max_distance_px) {
  const Shift shift = CommonShift(keypoints, chosen, others, usable, max_shake_px);
  const KeypointGrid grid(others, max_distance_px, usable);
  std::vector<uint32_t> found;
  int shared = 0;
  found.reserve(chosen.size());
  for (const uint32_t k : chosen) {
    float best = std::numeric_limits<float>::infinity();
    uint32_t nearest = kNoKeypoint;
    grid.ForEachWithin(keypoints[k] + shift.px, max_distance_px, [&](uint32_t other, float squared) {
      if (squared > best || (squared == best && other >= nearest)) return;
      best = squared;
      nearest = other;
    });
    shared += nearest != kNoKeypoint ? 1 : 0;
    found.push_back(nearest);
  }
  if (shared > 0 && IsByChance(shift, shared, max_distance_px)) found.assign(chosen.size(), kNoKeypoint);
  return found;
}

}  // namespace s2gs
