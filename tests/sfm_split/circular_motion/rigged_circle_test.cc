#include "sfm_split/circular_motion/rigged_circle.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>
#include <random>
#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/circular_motion/rigged_circle_scene.h"
#include "tests/support/synthetic_scan.h"

namespace s2gs {
namespace {

// So few matches, most of them wrong, that hardly a pair shows a motion of its own; the second station begins
// where the first did not.
SyntheticTurntableOptions Weak(uint64_t seed) {
  SyntheticTurntableOptions options;
  options.seed = seed;
  options.stations = 2;
  options.min_elevation_deg = 15;
  options.max_elevation_deg = 35;
  options.steps = 18;
  options.step_deg = 20;
  options.station_start_deg = 47;
  options.num_object_points = 60;
  options.num_platter_points = 0;
  options.num_background_points = 60;
  options.max_view_change_deg = 50;
  options.match_recall = 0.4;
  options.pixel_noise = 0.5;
  options.outlier_share = 0.7;
  return options;
}

// The cameras of the stations' first photos, in a world of another frame and unit.
ColmapModel BackgroundOf(const SyntheticTurntable& turntable) {
  const Eigen::Matrix3d turn = ExpRotation<double>(Eigen::Vector3d(0.4, -0.9, 0.3));
  constexpr double kScale = 2.5;
  const Eigen::Vector3d shift(3, -1, 2);
  ColmapModel model;
  for (const Camera& camera : turntable.scene.cameras) model.cameras[camera.camera_id] = camera;
  std::map<int, bool> is_known;
  uint32_t id = 0;
  for (const View& view : turntable.scene.views) {
    ++id;
    if (is_known[view.station]) continue;
    is_known[view.station] = true;
    ColmapImage& image = model.images[id];
    image.image_id = id;
    image.name = view.name;
    image.camera_id = view.camera_id;
    const Eigen::Matrix3d rotation = view.cam_from_world.rotation.toRotationMatrix() * turn.transpose();
    image.cam_from_world = {Eigen::Quaterniond(rotation),
                            kScale * view.cam_from_world.translation - rotation * shift};
  }
  return model;
}

struct Fit {
  SyntheticTurntable turntable;
  std::vector<AlignedScene> scenes;
};

Fit FitScan(const SyntheticTurntableOptions& options, bool shuffled = false) {
  Fit fit;
  fit.turntable = MakeSyntheticTurntable(options);
  ScanFeatures features = SyntheticScanFeatures(fit.turntable);
  std::mt19937 rng(7);
  for (ImagePairMatches& pair : features.object_pairs) {
    if (!shuffled) break;
    std::vector<uint32_t> second;
    for (const FeatureMatch& match : pair.matches) second.push_back(match.point2D_idx2);
    std::shuffle(second.begin(), second.end(), rng);
    for (size_t m = 0; m < second.size(); ++m) pair.matches[m].point2D_idx2 = second[m];
  }
  Reporter reporter;
  fit.scenes = ScenesFromRiggedCircles(features, PossibleObjectPairs(features, false),
                                       BackgroundOf(fit.turntable), 1.0, reporter);
  return fit;
}

// The largest error of the turn between a photo and the first [degrees], about the axis that points up.
double WorstTurnDeg(const Fit& fit) {
  double worst = 0;
  const std::vector<View>& truth = fit.turntable.scene.views;
  const std::vector<View>& found = fit.scenes[0].scene.views;
  for (size_t i = 0; i < found.size(); ++i) {
    const double off = (found[i].angle_deg - found[0].angle_deg) - (truth[i].angle_deg - truth[0].angle_deg);
    worst = std::max(worst, std::abs(WrapAngle(off * kDegree)) / kDegree);
  }
  return worst;
}

TEST(RiggedCircle, StationsTellOneAxisTogether) {
  for (const uint64_t seed : {1, 2, 3}) {
    const Fit fit = FitScan(Weak(seed));
    ASSERT_FALSE(fit.scenes.empty()) << seed;
    ASSERT_EQ(fit.scenes[0].scene.views.size(), 36U) << seed;
    EXPECT_LT(WorstTurnDeg(fit), 0.5) << seed;  // measured .003 to .11: of where the second station begins
    EXPECT_TRUE(fit.scenes[0].scene.scale_observable);
    // Relative poses of photos of both stations as the object sees them.
    const std::vector<View>& truth = fit.turntable.scene.views;
    const std::vector<View>& found = fit.scenes[0].scene.views;
    double worst = 0;
    for (size_t i = 0; i < found.size(); ++i) {
      ASSERT_EQ(found[i].name, truth[i].name);
      const Eigen::Quaterniond a =
          found[i].CamFromObject().rotation * found[0].CamFromObject().rotation.inverse();
      const Eigen::Quaterniond b =
          truth[i].CamFromObject().rotation * truth[0].CamFromObject().rotation.inverse();
      worst = std::max(worst, a.angularDistance(b) / kDegree);
    }
    EXPECT_LT(worst, 3) << seed;  // measured .9 to 1.9: of the axis' direction, before any adjustment
  }
}

TEST(RiggedCircle, MatchesThatSayNothingAreNotBelieved) {
  const Fit fit = FitScan(Weak(4), /*shuffled=*/true);
  EXPECT_TRUE(fit.scenes.empty());
}

TEST(RiggedCircle, OneStationIsNoRig) {
  SyntheticTurntableOptions options = Weak(5);
  options.stations = 1;
  EXPECT_TRUE(FitScan(options).scenes.empty());
}

}  // namespace
}  // namespace s2gs
