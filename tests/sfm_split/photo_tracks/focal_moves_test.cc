// How far poses by patches may move the focal length. Places are exact projections of points that no keypoint
// sees; the scene that is adjusted has a longer focal length and is as much farther off, which keypoints
// hardly tell from the truth.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <string>
#include <vector>

#include "sfm_split/photo_tracks/photo_adjustment.h"
#include "sfm_split/scene/camera_model.h"
#include "sfm_split/scene/projection_jacobians.h"
#include "tests/support/random_numbers.h"
#include "tests/support/synthetic_models.h"
#include "tests/support/synthetic_scan.h"

namespace s2gs {
namespace {

class FocalMoves : public testing::Test {
 protected:
  FocalMoves() {
    SyntheticTurntableOptions options;
    options.stations = 1;
    options.steps = 24;
    options.step_deg = 15;
    options.num_object_points = 300;
    options.num_background_points = 0;
    options.max_view_change_deg = 70;
    options.pixel_noise = 0.3;
    turntable_ = MakeSyntheticTurntable(options);
    features_ = SyntheticScanFeatures(turntable_);
  }

  // The true scene, its focal length and distance `factor` times as large.
  AlignedScene Start(double factor) const {
    ColmapModel object = SyntheticObjectModel(turntable_);
    ModelFaults faults;
    faults.focal_factor = factor;
    DamageModel(faults, 1, &object);
    double distance = 0;
    for (const auto& [id, image] : object.images)
      distance += image.cam_from_world.translation.z() / static_cast<double>(object.images.size());
    for (auto& [id, image] : object.images) image.cam_from_world.translation.z() += (factor - 1) * distance;
    AlignedScene aligned = AlignScene(object, nullptr, StationsOf(features_));
    EXPECT_EQ(aligned.scene.views.size(), turntable_.scene.views.size());
    return aligned;
  }

  // Where photos truly show the object's points, as none of the model's.
  std::vector<AlignedTrack> Tracks(const AlignedScene& aligned, double sigma_px) const {
    RandomNumbers random(3);
    std::map<std::string, const View*> view_of;
    for (const View& view : turntable_.scene.views) view_of[view.name] = &view;
    const ColmapModel truth = SyntheticObjectModel(turntable_);
    const uint64_t next_id = aligned.object.points3D.rbegin()->first + 1;
    std::map<std::string, uint32_t> id_of;
    for (const auto& [id, image] : aligned.object.images) id_of[image.name] = id;
    std::vector<AlignedTrack> tracks;
    for (const auto& [id, point] : truth.points3D) {
      AlignedTrack track;
      track.point3D_id = next_id + tracks.size();
      track.patch.centre = aligned.object.points3D.at(id).xyz;
      for (const ColmapTrackElement& element : point.track) {
        const ColmapImage& image = truth.images.at(element.image_id);
        const Camera& camera = truth.cameras.at(image.camera_id);
        TrackPlace place;
        place.image_id = id_of.at(image.name);
        place.place.is_found = true;
        place.place.sigma_px = sigma_px / understated_;
        place.is_beside = understated_ > 1;
        EXPECT_TRUE(ProjectWithJacobians(camera.model, camera.params.data(), image.cam_from_world * point.xyz,
                                         &place.place.xy, nullptr, nullptr));
        for (int k = 0; k < 2; ++k) place.place.xy(k) += sigma_px * random.Normal();
        track.places.push_back(place);
      }
      if (track.places.size() >= 3) tracks.push_back(track);
    }
    return tracks;
  }

  // By a focal length that is off by `factor` and known to `focal_sigma_px`.
  PhotoAdjustment Adjust(double factor, double focal_sigma_px, double place_sigma_px,
                         size_t num_tracks = 1000) {
    aligned_ = Start(factor);
    joint_ = {};
    joint_.sigma_px = 0.3;
    joint_.focal_sigma_px = {focal_sigma_px};
    std::vector<AlignedTrack> tracks = Tracks(aligned_, place_sigma_px);
    tracks.resize(std::min(tracks.size(), num_tracks));
    HeldBackKeypoints none;
    for (const ScanImage& image : features_.images) none.emplace_back(image.keypoints.size(), false);
    Reporter reporter;
    return AdjustByTracks([&](PhotosLookedIn) { return tracks; }, features_, none, {}, {},
                          {JointModel::kSharedStations, {}}, {}, reporter, &aligned_, &joint_);
  }

  double FocalLengthPx(const AlignedScene& aligned) const {
    return FocalLengths(aligned.scene.cameras.front()).x();
  }

  SyntheticTurntable turntable_;
  ScanFeatures features_;
  AlignedScene aligned_;
  JointReport joint_;
  double understated_ = 1;  // errors of places over what these say of themselves, beside tracks' photos
};

TEST_F(FocalMoves, PlacesThatBearEachOtherOutMayMoveItHoweverWellItSeemsKnown) {
  constexpr double kFactor = 1.15;
  const double start_px = FocalLengthPx(Start(kFactor));
  const PhotoAdjustment result = Adjust(kFactor, 0.01, 0.03);
  EXPECT_TRUE(result.is_taken) << result.finding;
  EXPECT_EQ(result.reason, PhotoReason::kHeldBackPatches);
  EXPECT_NEAR(std::log(start_px / FocalLengthPx(aligned_)), std::log(kFactor), 0.1 * std::log(kFactor));
}

// Places of so much noise that those held back do not tell which poses are better: standard deviations that
// fall are no ground for more than a tenth, or what the focal length is known to.
TEST_F(FocalMoves, OthersMayMoveItByATenthOrWithinWhatItIsKnownTo) {
  const auto adjust = [&](double factor, double part, size_t num_tracks) {
    return Adjust(factor, part * std::log(factor) * FocalLengthPx(Start(factor)) / 3, 2, num_tracks);
  };
  const PhotoAdjustment refused = adjust(1.15, 0.9, 150);
  EXPECT_FALSE(refused.is_taken);
  EXPECT_EQ(refused.finding, "patches ask for another focal length");
  EXPECT_EQ(FocalLengthPx(aligned_), FocalLengthPx(Start(1.15)));
  EXPECT_EQ(adjust(1.15, 3, 150).reason, PhotoReason::kStandardDeviations);
  EXPECT_EQ(adjust(1.06, 0.9, 300).reason, PhotoReason::kStandardDeviations);
}

// Places that err by more than noise are refused; that they bear each other out by another focal length says
// how well it is known.
TEST_F(FocalMoves, RefusedPlacesWidenItsDeviation) {
  constexpr double kFactor = 1.15;
  understated_ = 4;
  const PhotoAdjustment result = Adjust(kFactor, 1, 0.12);
  EXPECT_EQ(result.facing_finding.find("patches are not the same from all around"), 0U)
      << result.facing_finding;
  EXPECT_FALSE(result.is_taken);
  ASSERT_EQ(result.refused_focal_px.size(), 1U);
  const double truth_px = FocalLengthPx(Start(1));
  // .04 % was measured.
  EXPECT_NEAR(result.refused_focal_px[0], truth_px, 0.002 * truth_px);
  EXPECT_NEAR(joint_.focal_sigma_px[0], std::hypot(1, FocalLengthPx(aligned_) - result.refused_focal_px[0]),
              1e-6);
}

}  // namespace
}  // namespace s2gs
