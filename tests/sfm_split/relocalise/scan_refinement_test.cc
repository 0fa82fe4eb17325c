#include "sfm_split/relocalise/scan_refinement.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <string>
#include <string_view>

#include "tests/sfm_split/relocalise/small_scan.h"
#include "tests/support/synthetic_models.h"
#include "tests/support/synthetic_scan.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

TEST(ScanRefinement, ImagesLeftOutComeBackAndErrorsShrinkToTheNoise) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(SmallScan());
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  ColmapModel object = SyntheticObjectModel(turntable, {2.5, Eigen::Quaterniond(0, 1, 0, 0), {1, 2, 3}});
  ColmapModel background = SyntheticStaticModel(turntable);
  ModelFaults faults;
  faults.rotation_deg = 0.1;
  faults.centre_rel = 0.002;
  faults.point_rel = 0.001;
  faults.missing_share = 0.15;
  faults.wrong_share = 0.1;
  DamageModel(faults, 3, &object);
  faults.missing_share = faults.wrong_share = 0;
  faults.focal_factor = 1.01;  // each reconstruction has its own idea of the camera
  DamageModel(faults, 4, &background);
  ASSERT_LT(object.images.size(), 36U);
  AlignedScene aligned = AlignScene(object, &background, StationsOf(features));
  const size_t aligned_images = aligned.scene.views.size();
  EXPECT_LT(aligned_images, object.images.size());
  Reporter reporter;
  const RefineReport report = RefineScan(features, &object, {}, {}, reporter, &aligned);
  EXPECT_EQ(aligned.scene.views.size(), 36U);
  EXPECT_EQ(aligned.object.images.size(), 36U);
  EXPECT_EQ(aligned.background.images.size(), 36U);
  EXPECT_EQ(report.relocalised.size(), 36 - aligned_images);
  EXPECT_TRUE(report.missing.empty());
  EXPECT_TRUE(report.is_stable);
  EXPECT_EQ(report.model, JointModel::kSharedStations);
  const Figures figures = Measure(turntable, aligned);
  EXPECT_LT(figures.composition, 1e-9);
  EXPECT_LT(figures.rotation_max_deg, 0.1);
  EXPECT_LT(figures.angle_max_deg, 0.1);
  EXPECT_NEAR(report.joint.sigma_px, 0.3, 0.05);
  // Every keypoint keeps its true label or loses one that nothing proves.
  for (size_t i = 0; i < features.images.size(); ++i) {
    for (size_t k = 0; k < features.images[i].labels.size(); ++k) {
      if (report.labels[i][k] != KeypointLabel::kUnknown) {
        EXPECT_EQ(report.labels[i][k], features.images[i].labels[k]);
      }
    }
  }
}

// The reconstructions' own tracks ask for a focal length that is far off; the keypoints, which are
// triangulated next, tell it. Were the cameras held from then on, 2 % would stay.
TEST(ScanRefinement, AFocalLengthThatRunsAwayAtFirstIsFoundLater) {
  class Listening : public Reporter {
   public:
    void Log(LogLevel /*level*/, std::string_view message) override {
      is_not_yet |= message == "the focal length cannot be observed yet";
      is_held |= message.find("cameras are held as they were") != std::string_view::npos;
    }
    bool is_not_yet = false;
    bool is_held = false;
  };
  const SyntheticTurntable turntable = MakeSyntheticTurntable(SmallScan());
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  ColmapModel object = SyntheticObjectModel(turntable);
  ColmapModel background = SyntheticStaticModel(turntable);
  ModelFaults faults;
  faults.focal_factor = 1.02;
  DamageModel(faults, 3, &object);
  DamageModel(faults, 4, &background);
  AlignedScene aligned = AlignScene(object, &background, StationsOf(features));
  // SfM's tracks as another lens would show them.
  KeepPoints(40, &aligned.object);
  KeepPoints(0, &aligned.background);
  const Vector2d middle = PrincipalPoint(turntable.scene.cameras[0]);
  for (auto& [id, image] : aligned.object.images) {
    for (ColmapPoint2D& keypoint : image.points2D) keypoint.xy = middle + 1.6 * (keypoint.xy - middle);
  }
  Listening reporter;
  RefineScan(features, &object, {}, {}, reporter, &aligned);
  EXPECT_TRUE(reporter.is_not_yet);
  EXPECT_FALSE(reporter.is_held);
  const double truth = FocalLengths(turntable.scene.cameras[0]).x();
  EXPECT_NEAR(FocalLengths(aligned.scene.cameras[0]).x() / truth, 1, 0.005);
}

TEST(ScanRefinement, ShakenPhotosComeBackAndKeepTheirAngles) {
  SyntheticTurntableOptions options = SmallScan();
  options.shake_deg = 0.25;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  ColmapModel object = SyntheticObjectModel(turntable);
  ModelFaults faults;
  faults.missing_share = 0.2;
  DamageModel(faults, 5, &object);
  const ColmapModel background = RoughBackground(turntable, features, 3);
  AlignedScene aligned = AlignScene(object, &background, StationsOf(features));
  Reporter reporter;
  const RefineReport report = RefineScan(features, &object, {}, {}, reporter, &aligned);
  EXPECT_EQ(report.model, JointModel::kFreeCameras);
  EXPECT_EQ(aligned.scene.views.size(), 36U);
  const Figures figures = Measure(turntable, aligned);
  EXPECT_LT(figures.composition, 1e-9);
  EXPECT_LT(figures.rotation_max_deg, 0.25);  // measured: 0.084
  EXPECT_LT(figures.angle_max_deg, 0.3);      // measured: 0.095
}

TEST(ScanRefinement, AWrongReferenceImageIsTakenOutToo) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(SmallScan());
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  const ColmapModel object = SyntheticObjectModel(turntable);
  const ColmapModel background = SyntheticStaticModel(turntable);
  AlignedScene aligned = AlignScene(object, &background, StationsOf(features));
  View& reference = aligned.scene.views[0];
  ASSERT_EQ(reference.angle_deg, 0);
  // All others turn away from it.
  const Eigen::Quaterniond turn(Eigen::AngleAxisd(1.5, Vector3d::UnitZ()));
  for (View& view : aligned.scene.views) {
    if (&view == &reference) continue;
    view.world_from_object = view.world_from_object * Rigid3{turn, Vector3d::Zero()};
    view.angle_deg += 1.5 * 180 / 3.14159265358979;
  }
  aligned.object.points3D.clear();
  Reporter reporter;
  const RefineReport report = RefineScan(features, nullptr, {}, {}, reporter, &aligned);
  EXPECT_EQ(aligned.scene.views.size(), 36U);
  ASSERT_EQ(report.doubted.size(), 1U);
  EXPECT_EQ(report.doubted[0], features.images[0].name);
  const Figures figures = Measure(turntable, aligned);
  EXPECT_LT(figures.rotation_max_deg, 0.1);
  EXPECT_LT(figures.angle_max_deg, 0.1);
}

TEST(ScanRefinement, OneStationNeedsNoBackground) {
  SyntheticTurntableOptions options = SmallScan();
  options.stations = 1;
  options.steps = 24;
  options.step_deg = 15;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  EXPECT_TRUE(features.static_pairs.empty());
  const ColmapModel object = SyntheticObjectModel(turntable);
  AlignedScene aligned = AlignScene(object, nullptr, StationsOf(features));
  Reporter reporter;
  const RefineReport report = RefineScan(features, &object, {}, {}, reporter, &aligned);
  EXPECT_EQ(aligned.scene.views.size(), 24U);
  EXPECT_FALSE(aligned.scene.scale_observable);
  EXPECT_TRUE(aligned.background.images.empty());
  EXPECT_LT(Measure(turntable, aligned).angle_max_deg, 0.15);

  RefineOptions chosen;
  chosen.chosen_variance = 4;
  aligned = AlignScene(object, nullptr, StationsOf(features));
  const RefineReport less_sure = RefineScan(features, &object, {}, chosen, reporter, &aligned);
  EXPECT_EQ(less_sure.priors.chosen_variance, 4);
  EXPECT_NEAR(less_sure.joint.axis_direction_sigma_deg / report.joint.axis_direction_sigma_deg, 2, 0.2);
}

// Only angles about one axis are compared with stated ones: where photos have poses of their own that is
// said.
TEST(ScanRefinement, StatedAnglesAreCheckedOrItIsSaidThatTheyAreNot) {
  SyntheticTurntableOptions options = SmallScan();
  options.stations = 1;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  const ColmapModel object = SyntheticObjectModel(turntable);
  RefineOptions refine;
  const auto refined = [&](JointModel model) {
    AlignedScene aligned = AlignScene(object, nullptr, StationsOf(features));
    JointOptions joint;
    joint.model = model;
    Reporter reporter;
    return RefineScan(features, &object, joint, refine, reporter, &aligned);
  };
  EXPECT_TRUE(refined(JointModel::kFreeObject).angle_contradictions.empty());
  for (const View& view : turntable.scene.views) refine.stated_angles_deg[view.name] = view.angle_deg;
  const RefineReport about_one_axis = refined(JointModel::kSharedStations);
  EXPECT_EQ(about_one_axis.known_angles.size(), 1U);
  EXPECT_TRUE(about_one_axis.angle_contradictions.empty());
  const RefineReport each_by_itself = refined(JointModel::kFreeObject);
  EXPECT_TRUE(each_by_itself.known_angles.empty());
  ASSERT_EQ(each_by_itself.angle_contradictions.size(), 1U);
  EXPECT_NE(each_by_itself.angle_contradictions[0].find("neither checked nor used"), std::string::npos);
}

// A photo of so few matches that they tell no angle stands where the table's equal steps put it, if most of
// them bear that out.
TEST(ScanRefinement, FewMatchesBearOutWhatEqualStepsSay) {
  constexpr int kPoor = 7;
  SyntheticTurntableOptions options = SmallScan();
  options.stations = 1;
  options.steps = 24;
  options.step_deg = 15;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  ColmapModel object = SyntheticObjectModel(turntable);
  object.images.erase(kPoor + 1);
  for (auto& [id, point] : object.points3D) {
    auto& track = point.track;
    track.erase(std::remove_if(track.begin(), track.end(),
                               [](const auto& element) { return element.image_id == kPoor + 1; }),
                track.end());
  }
  for (const auto& [num_matches, num_wrong] : {std::pair(3, 0), std::pair(5, 3)}) {
    ScanFeatures features = SyntheticScanFeatures(turntable);
    // One with each of so many other photos.
    int kept = 0;
    for (ImagePairMatches& pair : features.object_pairs) {
      if (pair.image1 != kPoor && pair.image2 != kPoor) continue;
      const int other = pair.image1 == kPoor ? pair.image2 : pair.image1;
      const bool is_kept = std::abs(other - kPoor) % 2 == 1 && kept < num_matches;
      pair.matches.resize(is_kept ? 1 : 0);
      if (!is_kept) continue;
      if (kept++ < num_wrong) {
        const size_t at = static_cast<size_t>(pair.image1 == kPoor ? pair.image2 : pair.image1);
        uint32_t& index = pair.image1 == kPoor ? pair.matches[0].point2D_idx2 : pair.matches[0].point2D_idx1;
        index = (index + 40) % static_cast<uint32_t>(features.images[at].keypoints.size());
      }
    }
    AlignedScene aligned = AlignScene(object, nullptr, StationsOf(features));
    ASSERT_EQ(aligned.scene.views.size(), 23U);
    Reporter reporter;
    const RefineReport report = RefineScan(features, &object, {}, {}, reporter, &aligned);
    if (num_wrong > 0) {
      EXPECT_EQ(aligned.scene.views.size(), 23U);
      continue;
    }
    ASSERT_EQ(aligned.scene.views.size(), 24U);
    ASSERT_EQ(report.relocalised.size(), 1U);
    EXPECT_NE(report.relocalised[0].how.find("from its equal steps"), std::string::npos)
        << report.relocalised[0].how;
    EXPECT_LT(Measure(turntable, aligned).angle_max_deg, 0.15);
  }
}

TEST(ScanRefinement, AnObjectTurnedOverIsSurvived) {
  SyntheticTurntableOptions options = SmallScan();
  options.flip_from_station = 2;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  ScanFeatures features = SyntheticScanFeatures(turntable);
  const ColmapModel object = SyntheticObjectModel(turntable);
  const ColmapModel background = SyntheticStaticModel(turntable);
  AlignedScene aligned = AlignScene(object, &background, StationsOf(features));
  ASSERT_EQ(aligned.solution.groups.size(), 2U);
  Reporter reporter;
  const RefineReport report = RefineScan(features, &object, {}, {}, reporter, &aligned);
  EXPECT_GE(aligned.scene.views.size(), 24U);
  EXPECT_LT(Measure(turntable, aligned).composition, 1e-9);
}

}  // namespace
}  // namespace s2gs
