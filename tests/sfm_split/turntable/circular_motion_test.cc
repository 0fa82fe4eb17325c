#include "sfm_split/turntable/circular_motion.h"

#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <cstdio>

#include "sfm_split/base/rotation.h"
#include "sfm_split/turntable/circular_likelihood.h"
#include "sfm_split/turntable/circular_scene.h"
#include "tests/support/synthetic_scan.h"

namespace s2gs {
namespace {

constexpr double kDegree = 3.14159265358979323846 / 180;

// A texture-poor object: few points a photo, which match a few steps apart, seam included.
SyntheticTurntableOptions Poor() {
  SyntheticTurntableOptions options;
  options.stations = 1;
  options.steps = 24;
  options.step_deg = 15;
  options.num_object_points = 120;
  options.num_platter_points = 0;
  options.num_background_points = 60;
  options.max_view_change_deg = 40;
  options.match_recall = 0.5;
  options.pixel_noise = 0.5;
  options.outlier_share = 0.3;
  options.has_prior_focal = false;
  return options;
}

TEST(CircularMotion, Truth) {
  SyntheticTurntableOptions options = Poor();
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  std::vector<int> numbers;
  const auto stations = CollectCircularStations(features, {1}, &numbers);
  CircularMatches data;
  data.num_photos = 24;
  data.chance = 1 / 150.0;
  for (const auto& pair : stations[0].pairs) {
    CircularMatches::Pair p{pair.photo1, pair.photo2, {}};
    for (const auto& m : pair.matches) p.matches.emplace_back(m.first - Eigen::Vector2d(320, 240), m.second - Eigen::Vector2d(320, 240));
    data.pairs.push_back(p);
  }
  CircularPriors priors;
  priors.focal = {{768, 0.44}};
  priors.distortion = {0};
  priors.least_log_focal = {std::log(192.0)};
  priors.most_log_focal = {std::log(6400.0)};
  CircularState state;
  state.lenses = {{std::log(768.0), 0}};
  const View& view = turntable.scene.views[0];
  CircularTurn turn;
  const Eigen::Vector3d n = view.cam_from_world.rotation * Eigen::Vector3d::UnitZ();
  Eigen::Vector3d p = view.cam_from_world.translation;
  p -= p.dot(n) * n;
  p.normalize();
  turn.frame << p, n.cross(p), n;
  for (int i = 0; i < 24; ++i) turn.angles.push_back(15 * kDegree * i);
  state.turns = {turn};
  state.sigma_px = 0.5;
  auto f = EvaluateCircular({data}, priors, state, false);
  std::printf("truth: gain %.1f sigma %.3f inliers %.0f; n %g %g %g\n", f.log_posterior, f.sigma_px, f.inliers, n.x(), n.y(), n.z());
  f = RefineCircular({data}, priors, CircularSteps::kEqual, 30, &state, nullptr);
  std::printf("refined: gain %.1f sigma %.3f inliers %.0f; focal %g step %g\n", f.log_posterior, f.sigma_px, f.inliers, std::exp(state.lenses[0].log_focal), state.turns[0].angles[1] / kDegree);
  f = RefineCircular({data}, priors, CircularSteps::kFree, 30, &state, nullptr);
  std::printf("free: gain %.1f sigma %.3f inliers %.0f; focal %g step %g last %g\n", f.log_posterior, f.sigma_px, f.inliers, std::exp(state.lenses[0].log_focal), state.turns[0].angles[1] / kDegree, state.turns[0].angles[23] / kDegree);
}

TEST(CircularMotion, Debug) {
  for (int seed = 1; seed <= 6; ++seed) {
    SyntheticTurntableOptions options = Poor();
    options.seed = static_cast<uint64_t>(seed);
    if (seed > 3) options.stations = 3;
    const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
    const ScanFeatures features = SyntheticScanFeatures(turntable);
    CircularFinding finding;
    Reporter reporter;
    const auto start = std::chrono::steady_clock::now();
    const AlignedScene aligned = SceneFromCircularMotion(features, {}, reporter, &finding);
    const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    size_t matches = 0;
    for (const auto& pair : features.object_pairs) matches += pair.matches.size();
    std::printf("seed %d: %zu matches, %.2f s, focal %.1f +- %.1f %%, sigma %.2f, closed %.1f open %.1f, placed %d\n",
                seed, matches, seconds, FocalLengths(finding.motion.cameras[0]).x(),
                100 * finding.motion.focal_sigma_log[0], finding.motion.sigma_px,
                finding.motion.closed_log_posterior, finding.motion.open_log_posterior,
                finding.placed_stations);
    for (const auto& fit : finding.motion.stations) {
      double most = 0;
      const double sign = fit.angles_rad[1] > 0 ? 1 : -1;
      for (size_t i = 0; i < fit.angles_rad.size(); ++i) {
        if (fit.placed[i] == 0) continue;
        most = std::max(most, std::abs(WrapAngle(sign * fit.angles_rad[i] - 15 * kDegree * static_cast<double>(i))) / kDegree);
      }
      std::printf("  found %d closes %d gain %.0f inliers %d / %d, worst angle %.3f, sign %g\n", fit.found, fit.closes,
                  fit.gain, fit.inliers, fit.matches, most, sign);
    }
  }
}

}  // namespace
}  // namespace s2gs
