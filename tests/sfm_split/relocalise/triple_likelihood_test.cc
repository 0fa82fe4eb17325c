#include "sfm_split/relocalise/triple_likelihood.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>

#include "sfm_split/base/angles.h"
#include "tests/support/synthetic_scan.h"

namespace s2gs {
namespace {

// Points in three photos are likelier as the table turned than as if it had turned by a tenth more or less.
TEST(GainOfTriples, IsGreatestAsTheTableTurned) {
  SyntheticTurntableOptions options;
  options.seed = 1;
  options.stations = 1;
  options.steps = 24;
  options.step_deg = 10;
  options.num_object_points = 200;
  options.num_platter_points = 0;
  options.pixel_noise = 0.5;
  options.outlier_share = 0.2;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  const std::vector<PhotoTriple> triples = PossibleTriples(features);
  const auto gain = [&](double factor) {
    AlignedScene aligned;
    aligned.scene = turntable.scene;
    const TurntableAxis& axis = aligned.scene.axis;
    for (View& view : aligned.scene.views) {
      const double more = (factor - 1) * view.angle_deg * kDegree;
      const Eigen::Quaterniond turn(Eigen::AngleAxisd(more, axis.direction));
      view.world_from_object = Rigid3{turn, axis.point - turn * axis.point} * view.world_from_object;
      view.angle_deg *= factor;
    }
    return GainOfTriples(features, aligned, triples, 0.5);
  };
  const double right = gain(1);
  EXPECT_GT(right, 0);
  EXPECT_GT(right, 1.1 * gain(1.1));  // measured 328 and 265
  EXPECT_GT(right, 1.1 * gain(0.9));  // 272
}

}  // namespace
}  // namespace s2gs
