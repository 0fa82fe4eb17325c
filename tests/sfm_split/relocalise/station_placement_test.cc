#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "sfm_split/relocalise/scan_refinement.h"
#include "sfm_split/single_axis/single_axis_scene.h"
#include "tests/sfm_split/relocalise/small_scan.h"
#include "tests/support/synthetic_models.h"
#include "tests/support/synthetic_scan.h"

namespace s2gs {
namespace {

using Eigen::Vector3d;

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
  EXPECT_EQ(aligned.scene.views.size(), 36U);
  const std::set<std::string> untied(report.untied.begin(), report.untied.end());
  for (const auto& [id, point] : aligned.background.points3D) {
    for (const auto& element : point.track)
      EXPECT_EQ(untied.count(aligned.background.images.at(element.image_id).name), 0U);
  }
  EXPECT_EQ(untied.count(aligned.scene.reference), 0U);
  for (size_t v = 0; v < aligned.scene.views.size(); ++v) {
    const std::string& name = aligned.scene.views[v].name;
    if (untied.count(name) > 0) EXPECT_TRUE(std::isinf(report.joint.angle_sigma_deg[v])) << name;
  }
  EXPECT_LT(Measure(turntable, aligned).rotation_max_deg, 0.1);
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
  options.seed = 58;
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
  const ColmapModel background = RoughBackground(turntable, features, 116);
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

}  // namespace
}  // namespace s2gs
