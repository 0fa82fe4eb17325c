#include "sfm_split/relocalise/scan_refinement.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <iterator>
#include <map>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "sfm_split/adjust/track_triangulation.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/relocalise/unmoved_keypoints.h"
#include "sfm_split/scene/pose_error.h"
#include "sfm_split/single_axis/single_axis_scene.h"
#include "sfm_split/turntable/table_angle.h"
#include "tests/support/random_numbers.h"
#include "tests/support/synthetic_models.h"
#include "tests/support/synthetic_scan.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

SyntheticTurntableOptions SmallScan() {
  SyntheticTurntableOptions options;
  options.stations = 3;
  options.steps = 12;
  options.step_deg = 30;
  options.num_object_points = 250;
  options.num_platter_points = 100;
  options.num_background_points = 300;
  options.max_view_change_deg = 70;
  options.pixel_noise = 0.3;
  return options;
}

struct Figures {
  double rotation_max_deg = 0;
  double angle_max_deg = 0;
  double composition = 0;  // of cam_from_object against cam_from_world * world_from_object, in the models
};

Figures Measure(const SyntheticTurntable& turntable, const AlignedScene& aligned) {
  Figures figures;
  PoseMap estimate;
  PoseMap truth;
  std::map<std::string, const View*> truth_of;
  for (const View& view : turntable.scene.views) {
    truth[view.name] = view.CamFromObject();
    truth_of[view.name] = &view;
  }
  std::vector<Eigen::Quaterniond> estimated_turns;
  std::vector<Eigen::Quaterniond> true_turns;
  std::map<std::string, Rigid3> background;
  for (const auto& [id, image] : aligned.background.images) background[image.name] = image.cam_from_world;
  std::map<std::string, Rigid3> object;
  for (const auto& [id, image] : aligned.object.images) object[image.name] = image.cam_from_world;
  for (const View& view : aligned.scene.views) {
    estimate[view.name] = object.at(view.name);
    estimated_turns.push_back(view.world_from_object.rotation);
    true_turns.push_back(truth_of.at(view.name)->world_from_object.rotation);
    const Rigid3 composed =
        (background.empty() ? view.cam_from_world : background.at(view.name)) * view.world_from_object;
    figures.composition = std::max(figures.composition,
                                   (composed.Matrix() - object.at(view.name).Matrix()).cwiseAbs().maxCoeff());
  }
  const PoseErrors errors = ComparePoses(estimate, truth);
  for (const double error : errors.rotation_deg)
    figures.rotation_max_deg = std::max(figures.rotation_max_deg, error);
  for (const double error :
       TurntableAngleErrorsDeg(estimated_turns, true_turns, turntable.scene.axis.direction)) {
    figures.angle_max_deg = std::max(figures.angle_max_deg, error);
  }
  return figures;
}

std::map<std::string, int> StationsOf(const ScanFeatures& features) {
  std::map<std::string, int> stations;
  for (const ScanImage& image : features.images) stations[image.name] = image.station;
  return stations;
}

// Leaves the first points of a model alone.
void KeepPoints(size_t count, ColmapModel* model) {
  while (model->points3D.size() > count) model->points3D.erase(std::prev(model->points3D.end()));
  for (auto& [id, image] : model->images) {
    for (ColmapPoint2D& keypoint : image.points2D) {
      if (model->points3D.count(keypoint.point3D_id) == 0) keypoint.point3D_id = kInvalidPoint3DId;
    }
  }
}

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
  EXPECT_EQ(report.mended.size(), 36 - aligned_images);
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

TEST(ScanRefinement, AStationThatTheBackgroundLacksIsPlacedByTheObject) {
  SyntheticTurntableOptions options = SmallScan();
  options.station_start_deg = 50;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  const ColmapModel object = SyntheticObjectModel(turntable);
  ColmapModel background = SyntheticStaticModel(turntable);
  std::vector<std::string> gone;
  for (const ScanImage& image : features.images) {
    if (image.station == 1) gone.push_back(image.name);
  }
  RemoveImages(gone, &background);
  AlignedScene aligned = AlignScene(object, &background, StationsOf(features));
  EXPECT_EQ(aligned.scene.views.size(), 24U);
  Reporter reporter;
  const RefineReport report = RefineScan(features, &object, {}, {}, reporter, &aligned);
  EXPECT_EQ(aligned.scene.views.size(), 36U);
  EXPECT_EQ(aligned.scene.num_stations, 3);
  EXPECT_EQ(report.placed_stations.size(), 1U);  // around the axis, by the static matches
  const Figures figures = Measure(turntable, aligned);
  EXPECT_LT(figures.composition, 1e-9);
  EXPECT_LT(figures.rotation_max_deg, 0.1);
  EXPECT_LT(figures.angle_max_deg, 0.1);
}

TEST(ScanRefinement, TheSingleAxisPlacesWhatFreeSfmCannot) {
  SyntheticTurntableOptions options = SmallScan();
  options.num_object_points = 90;
  options.num_platter_points = 30;
  options.outlier_share = 0.2;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  const ColmapModel background = SyntheticStaticModel(turntable);
  Reporter reporter;
  SingleAxisSolution solution;
  AlignedScene aligned = SceneFromSingleAxis(features, &background, {}, reporter, &solution);
  ASSERT_TRUE(solution.found) << solution.reason;
  RefineScan(features, nullptr, {}, {}, reporter, &aligned);
  EXPECT_EQ(aligned.scene.views.size(), 36U);
  const Figures figures = Measure(turntable, aligned);
  EXPECT_LT(figures.composition, 1e-9);
  EXPECT_LT(figures.rotation_max_deg, 0.2);
}

// The background's cameras of each station's first photo, a little wrong.
ColmapModel RoughBackground(const SyntheticTurntable& turntable, const ScanFeatures& features,
                            uint32_t seed) {
  ColmapModel background = SyntheticStaticModel(turntable);
  ModelFaults faults;
  faults.rotation_deg = 0.15;
  faults.centre_rel = 0.003;
  DamageModel(faults, seed, &background);
  std::set<int> stations;
  std::vector<std::string> others;
  for (const ScanImage& image : features.images) {
    if (!stations.insert(image.station).second) others.push_back(image.name);
  }
  RemoveImages(others, &background);
  return background;
}

TEST(ScanRefinement, WhereMatchesAreFewStationsStandAsTheBackgroundsReconstructionHasThem) {
  SyntheticTurntableOptions options = SmallScan();
  options.rotating_share = 0.85;
  options.outlier_share = 0.1;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  for (const ImagePairMatches& pair : features.static_pairs) EXPECT_LT(pair.matches.size(), 8U);
  const ColmapModel background = RoughBackground(turntable, features, 3);
  Reporter reporter;
  SingleAxisSolution solution;
  AlignedScene aligned = SceneFromSingleAxis(features, &background, {}, reporter, &solution);
  ASSERT_TRUE(solution.found) << solution.reason;
  const RefineReport report = RefineScan(features, nullptr, {}, {}, reporter, &aligned);
  EXPECT_EQ(aligned.scene.views.size(), 36U);
  EXPECT_TRUE(report.untied.empty());
  const Figures figures = Measure(turntable, aligned);
  EXPECT_LT(figures.rotation_max_deg, 0.1);  // measured: 0.033
  EXPECT_LT(figures.angle_max_deg, 0.6);     // measured: 0.28
}

TEST(ScanRefinement, ABackgroundsReconstructionThatContradictsTheObjectPlacesNoStation) {
  SyntheticTurntableOptions options = SmallScan();
  options.rotating_share = 0.85;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  const ColmapModel object = SyntheticObjectModel(turntable);
  ColmapModel background = RoughBackground(turntable, features, 3);
  AlignedScene aligned = AlignScene(object, &background, StationsOf(features));
  ASSERT_EQ(aligned.scene.views.size(), 36U);
  const Rigid3 tilt{Eigen::Quaterniond(Eigen::AngleAxisd(0.15, Vector3d::UnitX())), Vector3d::Zero()};
  for (const ScanImage& image : features.images) {
    const auto found = aligned.cam_from_background.find(image.name);
    if (image.station == 2 && found != aligned.cam_from_background.end())
      found->second = tilt * found->second;
  }
  Reporter reporter;
  const RefineReport report = RefineScan(features, nullptr, {}, {}, reporter, &aligned);
  EXPECT_EQ(report.untied.size(), 12U);
  EXPECT_EQ(aligned.scene.views.size(), 24U);
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

// As a photo that the object's points placed stands, which sees none of the background.
TEST(ScanRefinement, APhotoBesideItsStationsCameraHasThatCamera) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(SmallScan());
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  const ColmapModel object = SyntheticObjectModel(turntable);
  const ColmapModel background = SyntheticStaticModel(turntable);
  AlignedScene aligned = AlignScene(object, &background, StationsOf(features));
  for (const size_t apart : {size_t{0}, size_t{17}}) {  // the reference, and another station's
    View& view = aligned.scene.views[apart];
    const Rigid3 turn = {Eigen::Quaterniond(Eigen::AngleAxisd(0.004, Vector3d(1, 2, 3).normalized())),
                         Vector3d(0.001, 0, -0.002)};
    view.cam_from_world = turn * view.cam_from_world;
  }
  Reporter reporter;
  const RefineReport report = RefineScan(features, &object, {}, {}, reporter, &aligned);
  ASSERT_EQ(report.model, JointModel::kSharedStations);
  ASSERT_EQ(aligned.scene.views.size(), 36U);
  std::map<int, Rigid3> camera;
  for (const View& view : aligned.scene.views) {
    const auto [entry, is_new] = camera.try_emplace(view.station, view.cam_from_world);
    EXPECT_EQ((entry->second.Matrix() - view.cam_from_world.Matrix()).norm(), 0) << view.name;
  }
  for (const double sigma : report.joint.angle_sigma_deg) EXPECT_LT(sigma, 0.1);  // measured: .024
  EXPECT_LT(Measure(turntable, aligned).angle_max_deg, 0.1);                      // measured: .019
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

TEST(ScanRefinement, AStationThatNoReconstructionHasIsPlacedByTheObjectsPoints) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(SmallScan());
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  ColmapModel object = SyntheticObjectModel(turntable);
  ColmapModel background = SyntheticStaticModel(turntable);
  std::vector<std::string> gone;
  for (const ScanImage& image : features.images) {
    if (image.station == 1) gone.push_back(image.name);
  }
  RemoveImages(gone, &object);
  RemoveImages(gone, &background);
  AlignedScene aligned = AlignScene(object, &background, StationsOf(features));
  EXPECT_EQ(aligned.scene.views.size(), 24U);
  Reporter reporter;
  RefineScan(features, nullptr, {}, {}, reporter, &aligned);
  EXPECT_EQ(aligned.scene.views.size(), 36U);
  EXPECT_EQ(aligned.scene.num_stations, 3);
  const Figures figures = Measure(turntable, aligned);
  EXPECT_LT(figures.composition, 1e-9);
  EXPECT_LT(figures.rotation_max_deg, 0.1);
  EXPECT_LT(figures.angle_max_deg, 0.1);
}

TEST(ScanRefinement, AStationSeenAsItsMirrorImageIsTakenOutAndComesBack) {
  SyntheticTurntableOptions options = SmallScan();
  options.seed = 13;
  options.steps = 10;
  options.step_deg = 36;
  options.num_object_points = 220;
  options.num_platter_points = 80;
  options.num_background_points = 250;
  options.max_view_change_deg = 60;
  options.match_recall = 0.7;
  options.pixel_noise = 0.5;
  options.outlier_share = 0.1;
  options.focal_widths = 5;
  options.distance = 0.7 * 5 / 1.2;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  const ColmapModel background = RoughBackground(turntable, features, 26);
  Reporter reporter;
  SingleAxisOptions axis_options;
  axis_options.num_directions = 120;
  axis_options.max_search_pairs = 30;
  SingleAxisSolution solution;
  AlignedScene aligned = SceneFromSingleAxis(features, &background, axis_options, reporter, &solution);
  ASSERT_TRUE(solution.found) << solution.reason;
  const RefineReport report = RefineScan(features, nullptr, {}, {}, reporter, &aligned);
  EXPECT_EQ(report.doubted.size(), 10U);
  EXPECT_EQ(aligned.scene.views.size(), 30U);
  const Figures figures = Measure(turntable, aligned);
  EXPECT_LT(figures.rotation_max_deg, 0.3);
  EXPECT_LT(figures.angle_max_deg, 0.3);
}

TEST(AlignScene, AStationStandsByAnImageThatTheObjectLacks) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(SmallScan());
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  ColmapModel object = SyntheticObjectModel(turntable);
  const ColmapModel background = RoughBackground(turntable, features, 3);
  std::string first_of_last;
  for (const auto& [id, image] : background.images) first_of_last = std::max(first_of_last, image.name);
  RemoveImages({first_of_last}, &object);
  const AlignedScene aligned = AlignScene(object, &background, StationsOf(features));
  EXPECT_EQ(aligned.scene.views.size(), 35U);
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
    ASSERT_EQ(report.mended.size(), 1U);
    EXPECT_NE(report.mended[0].how.find("from its equal steps"), std::string::npos) << report.mended[0].how;
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

TEST(TrackTriangulation, TracksHoldOnePointDespiteWrongMatches) {
  SyntheticTurntableOptions options = SmallScan();
  options.outlier_share = 0.3;
  options.pixel_noise = 0.2;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  const std::vector<PosedImage> posed = TruePosesOfObject(turntable);
  const std::vector<Keypoints> keypoints = KeypointsOf(features);
  TrackOptions track_options;
  track_options.max_error_px = 2;
  const std::vector<TrackPoint> points =
      TriangulateTracks(posed, keypoints, features.object_pairs, track_options);
  std::vector<ImagePairMatches> reversed(features.object_pairs.rbegin(), features.object_pairs.rend());
  const std::vector<TrackPoint> again = TriangulateTracks(posed, keypoints, reversed, track_options);
  ASSERT_EQ(points.size(), again.size());
  size_t right = 0;
  size_t all = 0;
  for (size_t p = 0; p < points.size(); ++p) {
    EXPECT_EQ(points[p].x_in_body, again[p].x_in_body);
    std::map<int, size_t> votes;
    std::set<int> images;
    for (const TrackElement& element : points[p].track) {
      EXPECT_TRUE(images.insert(element.image).second);
      ++votes[turntable.images[static_cast<size_t>(element.image)].keypoints[element.keypoint].point];
    }
    size_t most = 0;
    for (const auto& [point, count] : votes) most = std::max(most, count);
    all += points[p].track.size();
    if (points[p].track.size() > 2)
      right += most;
    else
      right += most == 2 ? 2 : 0;
  }
  EXPECT_GT(points.size(), 250U);
  EXPECT_GT(static_cast<double>(right), 0.97 * static_cast<double>(all));
}

TEST(TrackTriangulation, NoParallaxGivesNoPoint) {
  Camera camera;
  camera.model = CameraModelId::kSimplePinhole;
  camera.width = camera.height = 640;
  camera.params = {700, 320, 320};
  const Rigid3 pose{Eigen::Quaterniond::Identity(), {0, 0, 2}};
  const std::vector<PosedImage> posed = {{true, &camera, pose}, {true, &camera, pose}};
  const std::vector<Keypoints> keypoints(2, Keypoints{{300, 310}});
  EXPECT_TRUE(TriangulateTracks(posed, keypoints, {{0, 1, {{0, 0}}}}, {}).empty());
}

TEST(TableAngle, IsFoundAmongOutliers) {
  Camera camera;
  camera.model = CameraModelId::kSimplePinhole;
  camera.width = camera.height = 640;
  camera.params = {700, 320, 320};
  const Rigid3 cam_from_world{Eigen::Quaterniond(Eigen::AngleAxisd(2, Vector3d::UnitX())), {0, 0.1, 3}};
  const TurntableAxis axis{{0.02, -0.01, 0}, Vector3d(0.05, 0.02, 1).normalized()};
  for (const double angle : {-3.1, -1.0, 0.0, 0.7, 3.14159}) {
    std::vector<PointInImage> points;
    uint64_t state = 88172645463325252;
    const auto next = [&] {  // xorshift, in [-1, 1)
      state ^= state << 13;
      state ^= state >> 7;
      state ^= state << 17;
      return static_cast<double>(state >> 11) / 4503599627370496.0 - 1;
    };
    const Eigen::Matrix3d turn = RotationAbout<double>(axis.direction, angle);
    for (int k = 0; k < 60; ++k) {
      PointInImage point;
      point.x_in_object = 0.5 * Vector3d(next(), next(), next());
      const Vector3d turned = axis.point + turn * (point.x_in_object - axis.point);
      point.xy = k % 2 == 0 ? *ProjectToImage(camera, cam_from_world * turned)
                            : Vector2d(320 + 300 * next(), 320 + 300 * next());
      points.push_back(point);
    }
    const TableAngleFit fit = FitTableAngle(camera, cam_from_world, axis, points, 2, 8);
    ASSERT_TRUE(fit.found);
    EXPECT_GE(fit.inliers, 30);
    EXPECT_LT(std::abs(WrapAngle(fit.angle_rad - angle)), 2e-3);
    EXPECT_FALSE(FitTableAngle(camera, cam_from_world, axis, std::vector<PointInImage>(), 2, 8).found);
  }
}

TEST(TableAngle, IsFoundFromMatchesWithoutPoints) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(SmallScan());
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  for (const int image : {1, 17, 30}) {
    std::vector<MatchInPosedImage> matches;
    for (const ImagePairMatches& pair : features.object_pairs) {
      if (pair.image2 != image) continue;
      for (const FeatureMatch& match : pair.matches) {
        const auto i = static_cast<size_t>(pair.image1);
        const auto j = static_cast<size_t>(pair.image2);
        MatchInPosedImage in_image;
        in_image.xy = features.images[j].keypoints[match.point2D_idx2].cast<double>();
        in_image.other_camera = &turntable.CameraOf(pair.image1);
        in_image.other_cam_from_object = turntable.scene.views[i].CamFromObject();
        in_image.other_xy = features.images[i].keypoints[match.point2D_idx1].cast<double>();
        if (matches.size() % 3 == 0) in_image.xy = 640 * Vector2d(0.2, 0.3) - 0.4 * in_image.xy;  // wrong
        matches.push_back(in_image);
      }
    }
    const View& view = turntable.scene.views[static_cast<size_t>(image)];
    const TableAngleFit fit =
        FitTableAngle(turntable.CameraOf(image), view.cam_from_world, turntable.scene.axis, matches, 2, 8);
    ASSERT_TRUE(fit.found);
    EXPECT_LT(std::abs(WrapAngle(fit.angle_rad - view.angle_deg * 3.14159265358979 / 180)), 3e-3);
    EXPECT_GT(fit.margin, 1.5);
  }
}

TEST(UnmovedKeypoints, FollowTheCommonShift) {
  Keypoints first;
  Keypoints second;
  for (int k = 0; k < 50; ++k) {
    first.emplace_back(static_cast<float>(13 * (k % 10) + 20), static_cast<float>(17 * (k / 10) + 30));
    second.push_back(first.back() + Eigen::Vector2f(3.25F, -2.5F));
  }
  second[7] += Eigen::Vector2f(4, 0);  // moved
  std::vector<uint32_t> chosen = {0, 7, 20, 49};
  for (uint32_t k = 1; k < 49; ++k) chosen.push_back(k);
  std::vector<bool> usable(50, true);
  usable[20] = false;
  const std::vector<uint32_t> found = FindUnmovedKeypoints(first, chosen, second, usable, 8, 1.5F);
  EXPECT_EQ(found[0], 0U);
  EXPECT_EQ(found[1], kNoKeypoint);
  EXPECT_EQ(found[2], kNoKeypoint);
  EXPECT_EQ(found[3], 49U);
}

TEST(UnmovedKeypoints, AShiftThatChanceExplainsIsNone) {
  RandomNumbers random(11);
  Keypoints first;
  Keypoints second;
  std::vector<uint32_t> chosen;
  for (uint32_t k = 0; k < 300; ++k) {
    first.push_back(Eigen::Vector2d(random.Uniform(0, 640), random.Uniform(0, 480)).cast<float>());
    second.push_back(Eigen::Vector2d(random.Uniform(0, 640), random.Uniform(0, 480)).cast<float>());
    chosen.push_back(k);
  }
  const std::vector<bool> usable(300, true);
  for (const uint32_t other : FindUnmovedKeypoints(first, chosen, second, usable, 8, 1.5F))
    EXPECT_EQ(other, kNoKeypoint);
  for (uint32_t k = 0; k < 40; ++k) second[k] = first[k] + Eigen::Vector2f(5, -4);
  const std::vector<uint32_t> found = FindUnmovedKeypoints(first, chosen, second, usable, 8, 1.5F);
  for (uint32_t k = 0; k < 40; ++k) EXPECT_EQ(found[k], k);
}

}  // namespace
}  // namespace s2gs
