#include "sfm_split/joint_system/track_weights.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "sfm_split/base/angles.h"
#include "tests/support/random_numbers.h"
#include "tests/support/synthetic_aligned_object.h"
#include "tests/support/synthetic_models.h"
#include "tests/support/synthetic_turntable.h"

namespace s2gs {
namespace {

constexpr int kTrackSteps = 36;

// One station's turn of steps of 10 degrees, exact but for noise, with tracks of given numbers of keypoints
// in photos next to each other.
struct TrackScan {
  JointProblem truth;
  JointProblem problem;

  // \param lag  the share of its motion by which the last keypoint of each track of two stays behind.
  TrackScan(uint64_t seed, const std::vector<int>& lengths, double lag) {
    SyntheticTurntableOptions options;
    options.seed = seed;
    options.stations = 1;
    options.steps = kTrackSteps;
    options.step_deg = 360.0 / kTrackSteps;
    options.num_object_points = 400;
    options.num_background_points = 0;
    options.pixel_noise = 0.3;
    options.camera_model = CameraModelId::kSimpleRadial;
    truth = MakeJointProblem(SyntheticAlignedObject(MakeSyntheticTurntable(options)));
    Cut(seed, lengths, lag);
    problem = truth;
    LensPrior lens;
    lens.focal = {{truth.cameras[0].params[0], 0.44}, {}};
    lens.distortion = 0;
    problem.priors.lenses = {lens};
  }

  void Cut(uint64_t seed, const std::vector<int>& lengths, double lag) {
    RandomNumbers random(seed);
    std::vector<std::vector<JointObservation>> tracks(truth.object.points.size());
    for (const JointObservation& o : truth.object.observations)
      tracks[static_cast<size_t>(o.point)].push_back(o);
    truth.object.observations.clear();
    for (size_t p = 0; p < tracks.size(); ++p) {
      std::vector<JointObservation>& track = tracks[p];
      const auto length = static_cast<size_t>(lengths[p % lengths.size()]);
      if (track.size() < length) continue;
      std::sort(track.begin(), track.end(),
                [](const JointObservation& a, const JointObservation& b) { return a.image < b.image; });
      const size_t first = random.Index(track.size() - length + 1);
      if (track[first + length - 1].image - track[first].image != static_cast<int>(length) - 1) continue;
      for (size_t k = first; k < first + length; ++k) truth.object.observations.push_back(track[k]);
      if (length != 2) continue;
      const Eigen::Vector2d before = track[first].xy;
      Eigen::Vector2d& xy = truth.object.observations.back().xy;
      xy -= lag * (xy - before);
    }
  }

  JointReport Adjust(bool weighs) {
    JointOptions options;
    options.model = JointModel::kSharedStations;
    options.compute_covariance = weighs;  // what comes with them
    Reporter reporter;
    return AdjustJointly(options, reporter, &problem);
  }

  double AxisErrorDeg() const {
    return std::acos(std::min(1.0, problem.AxisDirection().dot(truth.AxisDirection()))) / kDegree;
  }
};

TEST(TrackWeights, ClassesAreOctavesOfSteps) {
  const std::vector<int> keypoints = {2, 3, 4, 5, 8, 9, 16, 17, 1000};
  std::vector<int> classes;
  for (const int k : keypoints) classes.push_back(TrackWeights::ClassOf(k));
  EXPECT_THAT(classes, testing::ElementsAre(0, 1, 1, 2, 2, 3, 3, 4, TrackWeights::kClasses - 1));
}

// Mean squares over scans.
struct Errors {
  double plain = 0;     // of the axis, when all tracks count alike [deg^2]
  double weighed = 0;   // [deg^2]
  double by_sigma = 0;  // of the axis over its standard deviation
  double by_focal_sigma = 0;
  int num_changed = 0;  // of scans
};

Errors MeasureErrors(int seeds, const std::vector<int>& lengths, double lag) {
  Errors errors;
  for (int seed = 0; seed < seeds; ++seed) {
    TrackScan plain(static_cast<uint64_t>(seed), lengths, lag);
    plain.Adjust(false);
    errors.plain += std::pow(plain.AxisErrorDeg(), 2) / seeds;
    TrackScan weighed(static_cast<uint64_t>(seed), lengths, lag);
    const JointReport report = weighed.Adjust(true);
    errors.weighed += std::pow(weighed.AxisErrorDeg(), 2) / seeds;
    errors.by_sigma += std::pow(weighed.AxisErrorDeg() / report.axis_direction_sigma_deg, 2) / seeds;
    const double focal_error = weighed.problem.cameras[0].params[0] - weighed.truth.cameras[0].params[0];
    errors.by_focal_sigma += std::pow(focal_error / report.focal_sigma_px[0], 2) / seeds;
    errors.num_changed += report.point_correlation > 0 ? 1 : 0;
  }
  return errors;
}

TEST(TrackWeights, ShortTracksThatSlideCountLessAndWidenTheStandardDeviations) {
  const Errors errors = MeasureErrors(8, {2, 2, 2, 4, 8}, 0.4);
  // Measured: 8 of 8; .189 > .095 degrees; .67 and .61 standard deviations.
  EXPECT_GE(errors.num_changed, 6);
  EXPECT_LE(std::sqrt(errors.weighed), 0.7 * std::sqrt(errors.plain));
  EXPECT_THAT(std::sqrt(errors.by_sigma), testing::AllOf(testing::Ge(0.4), testing::Le(1.3)));
  EXPECT_LE(std::sqrt(errors.by_focal_sigma), 1.2);
}

TEST(TrackWeights, IndependentErrorsCostNothing) {
  const Errors errors = MeasureErrors(12, {2, 2, 4, 8}, 0);
  // Measured: .0754 > .0755 degrees; .93 standard deviations; 3 of 12.
  EXPECT_LE(std::sqrt(errors.weighed), 1.05 * std::sqrt(errors.plain));
  EXPECT_THAT(std::sqrt(errors.by_sigma), testing::AllOf(testing::Ge(0.7), testing::Le(1.3)));
  EXPECT_LE(errors.num_changed, 6);
}

TEST(TrackWeights, OneLengthAloneSaysNothingOfItself) {
  TrackScan scan(7, {2}, 0.4);
  EXPECT_EQ(scan.Adjust(true).point_correlation, 0);
  for (const JointObservation& o : scan.problem.object.observations) EXPECT_EQ(o.weight, 1);
}

}  // namespace
}  // namespace s2gs
