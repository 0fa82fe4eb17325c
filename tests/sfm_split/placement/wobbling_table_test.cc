// Whether patches of the photos tell that a table wobbles, and do not where it does not.
#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <string>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/placement/pose_finish.h"
#include "sfm_split/scene/camera_model.h"
#include "sfm_split/scene/pose_error.h"
#include "tests/support/synthetic_grey_photos.h"
#include "tests/support/synthetic_models.h"
#include "tests/support/synthetic_scan.h"

namespace s2gs {
namespace {

constexpr double kNoisePx = 0.4;  // of keypoints

SyntheticTurntable MakeTurntable(double wobble_deg) {
  SyntheticTurntableOptions options;
  options.stations = 1;
  options.steps = 18;
  options.step_deg = 20;
  options.num_object_points = 400;
  options.num_platter_points = 100;
  options.num_background_points = 0;
  options.max_view_change_deg = 70;
  options.width = 320;
  options.height = 240;
  options.focal_widths = 1.6;
  options.pixel_noise = kNoisePx;
  SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  for (size_t i = 0; i < turntable.images.size(); ++i) {
    View& view = turntable.scene.views[i];
    const double angle = view.angle_deg * kDegree;
    const Rigid3 tilt{Eigen::Quaterniond(ExpRotation<double>(
                          wobble_deg * kDegree * Eigen::Vector3d(std::sin(angle), std::sin(2 * angle), 0))),
                      Eigen::Vector3d::Zero()};
    view.world_from_object = tilt * view.world_from_object;
    SyntheticImage& image = turntable.images[i];
    image.world_from_platter = tilt * image.world_from_platter;
    for (SyntheticKeypoint& keypoint : image.keypoints) {
      if (keypoint.point < 0 || keypoint.body == SyntheticBody::kStatic) continue;
      const SyntheticPoint& point = turntable.points[static_cast<size_t>(keypoint.point)];
      const auto exact = ProjectToImage(turntable.CameraOf(static_cast<int>(i)),
                                        turntable.CamFromBody(static_cast<int>(i), point.body) * point.x);
      if (!exact) continue;
      keypoint.xy += *exact - keypoint.exact_xy;
      keypoint.exact_xy = *exact;
    }
  }
  return turntable;
}

struct Finished {
  JointModel model = JointModel::kAuto;
  double before_deg = 0;  // rotation error, median
  double after_deg = 0;
};

double ErrorOf(const SyntheticTurntable& turntable, const AlignedScene& aligned) {
  PoseMap estimate;
  PoseMap truth;
  for (const View& view : turntable.scene.views) truth[view.name] = view.CamFromObject();
  for (const View& view : aligned.scene.views) estimate[view.name] = view.CamFromObject();
  return UpperMedian(ComparePoses(estimate, truth).rotation_deg);
}

// From poses of a pure turn. \param score  of object poses of their own, as the adjustment found it.
Finished Finish(double wobble_deg, double score, JointModel asked = JointModel::kAuto) {
  const SyntheticTurntable turntable = MakeTurntable(wobble_deg);
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  const std::map<std::string, GreyPhoto> photos = RenderGreyPhotos(turntable);
  Reporter reporter;
  ScanPlacement result;
  result.best.is_usable = true;
  const ColmapModel object = SyntheticObjectModel(turntable);
  result.best.aligned = AlignScene(object, nullptr, StationsOf(features));
  JointOptions shared;
  shared.model = JointModel::kSharedStations;
  result.best.refined = RefineScan(features, &object, shared, {}, reporter, &result.best.aligned);
  ModelTest test;
  test.general = JointModel::kFreeObject;
  test.score = score;
  result.best.refined.model_tests = {test};
  Finished finished;
  finished.before_deg = ErrorOf(turntable, result.best.aligned);
  PlacementOptions options;
  options.joint.model = asked;
  const CandidateLikelihood likelihood(features);
  const CircleRefinement circles(features, likelihood, options.refine, options.joint, reporter);
  Stopwatch watch;
  PoseFinish finish(features, likelihood, circles, options, reporter, &watch, &result);
  finish.FinishWithoutSilhouettes([&](const std::string& name) { return photos.at(name); });
  finished.after_deg = ErrorOf(turntable, result.best.aligned);
  finished.model = result.best.refined.model;
  EXPECT_EQ(result.best.refined.joint.model, finished.model);
  return finished;
}

TEST(WobblingTable, PatchesTellHowItWobbles) {
  const Finished finished = Finish(0.5, 2);
  EXPECT_EQ(finished.model, JointModel::kWobblingTable);
  EXPECT_LT(finished.after_deg, 0.1 * finished.before_deg);  // .314 to .0092 degrees
}

TEST(WobblingTable, IsNotTakenForOneThatDoesNotWobble) {
  const Finished finished = Finish(0, 2);
  EXPECT_EQ(finished.model, JointModel::kSharedStations);
  EXPECT_LT(finished.after_deg, 0.7 * finished.before_deg);  // .0100 to .0035 degrees
}

TEST(WobblingTable, IsNotAskedForWherePhotosDoNotOrAnotherModelIsGiven) {
  EXPECT_EQ(Finish(0.5, 1.4).model, JointModel::kSharedStations);
  EXPECT_EQ(Finish(0.5, 2, JointModel::kSharedStations).model, JointModel::kSharedStations);
}

}  // namespace
}  // namespace s2gs
