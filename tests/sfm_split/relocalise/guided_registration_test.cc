#include "sfm_split/relocalise/guided_registration.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <random>
#include <set>
#include <string>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "tests/support/synthetic_models.h"
#include "tests/support/synthetic_scan.h"
#include "tests/support/synthetic_turntable.h"

namespace s2gs {
namespace {

SyntheticTurntableOptions Options() {
  SyntheticTurntableOptions options;
  options.stations = 3;
  options.steps = 10;
  options.step_deg = 36;
  options.pixel_noise = 0.3;
  options.dropout = 0.2;
  options.num_background_points = 300;
  options.num_extra_keypoints = 100;
  options.max_view_change_deg = 60;
  options.descriptors = true;
  return options;
}

// A scan that knows the true scene, without the photos that were lost.
struct Scan {
  SyntheticTurntable turntable;
  ScanFeatures features;
  AlignedScene aligned;
  std::vector<ImagePairMatches> pairs;

  Scan(const SyntheticTurntableOptions& options, const std::set<int>& lost)
      : turntable(MakeSyntheticTurntable(options)), features(SyntheticScanFeatures(turntable)) {
    aligned.scene = turntable.scene;
    aligned.object = SyntheticObjectModel(turntable);
    aligned.background = SyntheticStaticModel(turntable);
    for (const View& view : turntable.scene.views)
      aligned.cam_from_background[view.name] = view.cam_from_world;
    std::vector<std::string> names;
    for (const int image : lost) names.push_back(turntable.scene.views[static_cast<size_t>(image)].name);
    RemoveImages(names, &aligned.object);
    RemoveImages(names, &aligned.background);
    std::vector<View>& views = aligned.scene.views;
    views.erase(std::remove_if(views.begin(), views.end(),
                               [&](const View& view) {
                                 return std::find(names.begin(), names.end(), view.name) != names.end();
                               }),
                views.end());
  }

  std::vector<uint8_t> Descriptors(int image) const {
    std::vector<uint8_t> bytes;
    for (const SiftDescriptor& descriptor : turntable.images[static_cast<size_t>(image)].descriptors)
      bytes.insert(bytes.end(), descriptor.begin(), descriptor.end());
    return bytes;
  }

  std::vector<GuidedPhoto> Register() {
    Reporter reporter;
    return RegisterByAppearance(
        features, [&](int image) { return Descriptors(image); }, GuidedOptions(), reporter, &aligned, &pairs);
  }

  // Over the views that are there: the largest errors.
  void ExpectRight(double max_angle_deg) const {
    std::map<std::string, const View*> truth;
    for (const View& view : turntable.scene.views) truth[view.name] = &view;
    for (const View& view : aligned.scene.views) {
      const View& expected = *truth.at(view.name);
      EXPECT_NEAR(WrapAngle((view.angle_deg - expected.angle_deg) * kDegree) / kDegree, 0, max_angle_deg)
          << view.name;
      EXPECT_LT((view.cam_from_world.Matrix() - expected.cam_from_world.Matrix()).norm(), 1e-9) << view.name;
      EXPECT_EQ(view.camera_id, expected.camera_id);
    }
  }
};

TEST(GuidedRegistration, PlacesLostPhotosOfAStation) {
  Scan scan(Options(), {3, 7, 12, 28});
  const std::vector<GuidedPhoto> placed = scan.Register();
  ASSERT_EQ(placed.size(), 4U);
  ASSERT_EQ(scan.aligned.scene.views.size(), 30U);
  scan.ExpectRight(0.2);
  for (size_t i = 1; i < 30; ++i)
    EXPECT_LT(scan.aligned.scene.views[i - 1].name, scan.aligned.scene.views[i].name);
  for (const View& view : scan.aligned.scene.views) {
    const auto same = std::find_if(scan.turntable.scene.views.begin(), scan.turntable.scene.views.end(),
                                   [&](const View& other) { return other.name == view.name; });
    EXPECT_EQ(view.station, same->station);
  }
  // New matches join keypoints of one point.
  size_t right = 0;
  size_t all = 0;
  for (const ImagePairMatches& pair : scan.pairs) {
    EXPECT_LT(pair.image1, pair.image2);
    for (const FeatureMatch& match : pair.matches) {
      const auto& keypoints1 = scan.turntable.images[static_cast<size_t>(pair.image1)].keypoints;
      const auto& keypoints2 = scan.turntable.images[static_cast<size_t>(pair.image2)].keypoints;
      right += keypoints1[match.point2D_idx1].point == keypoints2[match.point2D_idx2].point ? 1 : 0;
      ++all;
    }
  }
  EXPECT_GT(all, 500U);
  EXPECT_GT(static_cast<double>(right), 0.99 * static_cast<double>(all));
}

TEST(GuidedRegistration, ACameraOfTheBackgroundWillDo) {
  std::set<int> lost;
  for (int image = 10; image < 20; ++image) lost.insert(image);
  SyntheticTurntableOptions options = Options();
  options.stations = 4;  // three stay, which place the background's reconstruction
  Scan scan(options, lost);
  // The background's reconstruction has another frame and unit.
  const Sim3 moved{
      2.5, Eigen::Quaterniond(Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 2, 3).normalized())), {1, -2, 0.5}};
  for (auto& [name, pose] : scan.aligned.cam_from_background) pose = TransformPose(moved, pose);
  EXPECT_EQ(scan.Register().size(), 10U);
  ASSERT_EQ(scan.aligned.scene.views.size(), 40U);
  scan.ExpectRight(0.2);
  EXPECT_EQ(scan.aligned.background.images.size(), 40U);
  std::set<int> stations;
  for (const View& view : scan.aligned.scene.views) stations.insert(view.station);
  EXPECT_EQ(stations.size(), 4U);
}

TEST(GuidedRegistration, WithoutACameraNothingIsPlaced) {
  std::set<int> lost;
  for (int image = 10; image < 20; ++image) lost.insert(image);
  Scan scan(Options(), lost);  // two stations do not place the background's reconstruction
  EXPECT_TRUE(scan.Register().empty());
  EXPECT_EQ(scan.aligned.scene.views.size(), 20U);
  EXPECT_TRUE(scan.pairs.empty());
}

TEST(GuidedRegistration, ForeignPhotosAreRefused) {
  // The photos show the same places, but nothing that looks like the object.
  Scan scan(Options(), {3, 7, 12, 28});
  std::mt19937 rng(5);
  for (const size_t image : {3, 7, 12, 28}) {
    std::vector<SiftDescriptor>& descriptors = scan.turntable.images[image].descriptors;
    std::shuffle(descriptors.begin(), descriptors.end(), rng);
  }
  EXPECT_TRUE(scan.Register().empty());
}

TEST(GuidedRegistration, AnObjectThatLooksTheSameAfterAHalfTurnIsRefused) {
  SyntheticTurntableOptions options = Options();
  options.repeated_share = 1;
  options.num_platter_points = 0;
  options.object_offset = {0, 0};
  Scan scan(options, {3, 7, 12, 28});
  for (const GuidedPhoto& photo : scan.Register()) ADD_FAILURE() << photo.name << " " << photo.inliers;
}

// A pebble that spans 45 px: five degrees move none of it by more than a keypoint may be off.
TEST(GuidedRegistration, AnAngleBesideThatAgreesAsNearlyIsNoOther) {
  SyntheticTurntableOptions options = Options();
  options.stations = 1;
  options.object_radius = 0.02;
  options.object_offset = {0, 0};
  options.num_platter_points = 0;
  Scan scan(options, {3, 7});
  EXPECT_EQ(scan.Register().size(), 2U);
  scan.ExpectRight(1);
}

TEST(GuidedRegistration, OptionsAreChecked) {
  EXPECT_FALSE(GuidedOptions().Check());
  GuidedOptions options;
  options.max_chance = 0;
  ASSERT_TRUE(options.Check());
  EXPECT_EQ(options.Check()->field, "max_chance");
  options = GuidedOptions();
  options.min_margin = 0.5;
  ASSERT_TRUE(options.Check());
  EXPECT_EQ(options.Check()->field, "min_margin");
}

}  // namespace
}  // namespace s2gs
