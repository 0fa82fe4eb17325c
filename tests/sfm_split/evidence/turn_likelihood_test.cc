#include "sfm_split/evidence/turn_likelihood.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <random>
#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/evidence/scan_evidence.h"
#include "sfm_split/evidence/step_evidence.h"
#include "sfm_split/scene/axis_turn.h"
#include "sfm_split/scene/camera_model.h"
#include "tests/support/synthetic_models.h"
#include "tests/support/synthetic_scan.h"

namespace s2gs {
namespace {

constexpr int kPhotos = 26;
constexpr double kRisk = 1.0 / 400;

// Before a camera that hardly looks down, unless said otherwise.
SyntheticTurntable MakeTurntable(double step_deg, double elevation_deg = 11) {
  SyntheticTurntableOptions options;
  options.stations = 1;
  options.steps = kPhotos;
  options.step_deg = step_deg;
  options.min_elevation_deg = options.max_elevation_deg = elevation_deg;
  options.num_object_points = 150;
  options.num_platter_points = 0;
  options.num_background_points = 0;
  options.distance = 1.4;  // so that paths around the axis are ellipses
  options.max_view_change_deg = 40;
  options.pixel_noise = 0.5;
  return MakeSyntheticTurntable(options);
}

// A vase beside the axis: what it shows goes around with it and lies in the same way before the camera in
// each photo, so that all photos match.
void AddVase(const SyntheticTurntable& turntable, double at_deg, ScanFeatures* features,
             uint32_t num_keypoints = 14) {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> any(-1, 1);
  std::normal_distribution<double> noise;
  std::vector<Eigen::Vector2d> shown;
  for (uint32_t k = 0; k < num_keypoints; ++k) shown.emplace_back(15 * any(random), 40 * any(random));
  const Camera& camera = turntable.scene.cameras[0];
  std::vector<uint32_t> first;
  for (size_t i = 0; i < features->images.size(); ++i) {
    ScanImage& image = features->images[i];
    first.push_back(static_cast<uint32_t>(image.keypoints.size()));
    const Eigen::Vector3d middle =
        turntable.scene.views[i].CamFromObject() *
        Eigen::Vector3d(0.06 * std::cos(at_deg * kDegree), 0.06 * std::sin(at_deg * kDegree), 0.04);
    const Eigen::Vector2d at = *ProjectToImage(camera, middle);
    for (const Eigen::Vector2d& beside : shown) {
      image.keypoints.push_back((at + beside + Eigen::Vector2d(noise(random), noise(random))).cast<float>());
      image.labels.push_back(KeypointLabel::kRotating);
    }
  }
  for (int i = 0; i < kPhotos; ++i) {
    for (int j = i + 1; j < kPhotos; ++j) {
      ImagePairMatches pair{i, j, {}};
      for (const ImagePairMatches& given : features->object_pairs) {
        if (given.image1 == i && given.image2 == j) pair = given;
      }
      for (uint32_t k = 0; k < num_keypoints; ++k)
        pair.matches.push_back({first[static_cast<size_t>(i)] + k, first[static_cast<size_t>(j)] + k});
      features->raw_pairs.push_back(pair);
    }
  }
}

std::vector<const View*> Pointers(const std::vector<View>& views) {
  std::vector<const View*> pointers;
  for (const View& view : views) pointers.push_back(&view);
  return pointers;
}

// The first and last photos of an arc are 60 degrees apart. What goes around does not move as it would if
// they closed a turn, nor along the lines of what stands on the table.
TEST(TurnLikelihood, AVaseThatGoesAroundAnArcSaysNothingOfItsAngles) {
  const SyntheticTurntable turntable = MakeTurntable(12);
  const std::vector<const Camera*> cameras(kPhotos, turntable.scene.cameras.data());
  for (int at_deg = 0; at_deg < 360; at_deg += 30) {
    ScanFeatures features = SyntheticScanFeatures(turntable);
    AddVase(turntable, at_deg, &features);
    const StepEvidence evidence =
        AskSteps(features, cameras, Pointers(turntable.scene.views), turntable.scene.axis, {},
                 std::vector<bool>(kPhotos, false), 1, kRisk);
    EXPECT_TRUE(evidence.misturned.empty()) << at_deg;
  }
}

// The last photo of an arc shows what the second one does, as a box does whose faces are printed alike: 60
// degrees before the first photo what is seen 12 degrees after it. The steps in between sum up to 300
// degrees, and each of them would be off by 3 were the gap another, which a camera sees that looks down.
TEST(TurnLikelihood, LookAlikesAcrossTheGapOfAnArcDoNotOutweighItsSteps) {
  const SyntheticTurntable turntable = MakeTurntable(12, 30);
  const std::vector<const Camera*> cameras(kPhotos, turntable.scene.cameras.data());
  ScanFeatures features = SyntheticScanFeatures(turntable);
  features.raw_pairs = features.object_pairs;
  const auto of_first = std::find_if(features.raw_pairs.begin(), features.raw_pairs.end(),
                                     [](const auto& pair) { return pair.image1 == 0 && pair.image2 == 1; });
  ASSERT_NE(of_first, features.raw_pairs.end());
  ImagePairMatches alike{0, kPhotos - 1, {}};
  const ScanImage& second = features.images[1];
  ScanImage& last = features.images[kPhotos - 1];
  for (const FeatureMatch& match : of_first->matches) {
    alike.matches.push_back({match.point2D_idx1, static_cast<uint32_t>(last.keypoints.size())});
    last.keypoints.push_back(second.keypoints[match.point2D_idx2]);
    last.labels.push_back(second.labels[match.point2D_idx2]);
  }
  features.raw_pairs.push_back(alike);
  const auto misturned = [&](const SyntheticTurntable& posed) {
    return AskSteps(features, cameras, Pointers(posed.scene.views), turntable.scene.axis, {},
                    std::vector<bool>(kPhotos, false), 1, kRisk)
        .misturned;
  };
  EXPECT_TRUE(misturned(turntable).empty());
  // Where a step within the arc is wrong by as much, the gap may well be the other one.
  SyntheticTurntable broken = turntable;
  for (size_t v = kPhotos / 2; v < broken.scene.views.size(); ++v) {
    View& view = broken.scene.views[v];
    view.angle_deg -= 24;
    view.world_from_object = TurnAbout(turntable.scene.axis, -24 * kDegree) * view.world_from_object;
  }
  EXPECT_FALSE(misturned(broken).empty());
}

// Wrong angles of a turn that closes do not hide what goes around.
TEST(TurnLikelihood, AVaseGoesAroundAClosedTurnWhateverTheAnglesSay) {
  const SyntheticTurntable turntable = MakeTurntable(360.0 / kPhotos);
  ScanFeatures features = SyntheticScanFeatures(turntable);
  AddVase(turntable, 20, &features);
  std::vector<int> images(kPhotos);
  std::iota(images.begin(), images.end(), 0);
  const auto mean_chance = [&](double of_angles) {
    std::vector<View> views = turntable.scene.views;
    for (View& view : views) view.angle_deg *= of_angles;
    double sum = 0;
    int num = 0;
    for (const TurnPair& pair : NearPairs(features, Pointers(views), images, images, {})) {
      for (const TurnPair::Match& match : pair.matches) {
        sum += match.chance;
        ++num;
      }
    }
    return sum / num;
  };
  EXPECT_GT(mean_chance(0.8), 0.9 * mean_chance(1));
}

// Between an arc's last photos and its first the vase is all that they share. It follows a motion of its own,
// which says nothing of how far they are apart. Where it is not asked what orbits, three pairs with some 160
// matches are held against the poses.
TEST(ProvenPairs, AVaseThatGoesAroundAnArcContradictsNothing) {
  const SyntheticTurntable turntable = MakeTurntable(7);
  AlignedScene aligned;
  aligned.scene = turntable.scene;
  aligned.object = SyntheticObjectModel(turntable);
  for (int at_deg = 0; at_deg < 360; at_deg += 30) {
    ScanFeatures features = SyntheticScanFeatures(turntable);
    AddVase(turntable, at_deg, &features, 60);
    const ScanEvidence evidence =
        GatherEvidence(features, aligned, JointReport(), {}, HoldBack(features), MatchFindings(), 4);
    EXPECT_EQ(evidence.contradicted_seams, 0) << at_deg;
    EXPECT_EQ(evidence.seam.all, 0) << at_deg;
    EXPECT_EQ(evidence.far_pairs, 0) << at_deg;
    EXPECT_GT(evidence.neighbour_pairs, 40) << at_deg;
  }
}

}  // namespace
}  // namespace s2gs
