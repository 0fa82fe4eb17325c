// How far poses by patches may move the focal length. Places are exact projections of points that no keypoint
// sees; the scene that is adjusted has a longer focal length and is as much farther off, which keypoints
// hardly tell from the truth.
#include <gtest/gtest.h>

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

constexpr double kPlaceSigmaPx = 0.03;

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
  std::vector<AlignedTrack> Tracks(const AlignedScene& aligned) const {
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
        place.place.sigma_px = kPlaceSigmaPx;
        EXPECT_TRUE(ProjectWithJacobians(camera.model, camera.params.data(), image.cam_from_world * point.xyz,
                                         &place.place.xy, nullptr, nullptr));
        for (int k = 0; k < 2; ++k) place.place.xy(k) += kPlaceSigmaPx * random.Normal();
        track.places.push_back(place);
      }
      if (track.places.size() >= 3) tracks.push_back(track);
    }
    return tracks;
  }

  // By a focal length that is off by `factor` and known to `focal_sigma_px`.
  PhotoAdjustment Adjust(double factor, double focal_sigma_px) {
    aligned_ = Start(factor);
    JointReport joint;
    joint.sigma_px = 0.3;
    joint.focal_sigma_px = {focal_sigma_px};
    std::vector<AlignedTrack> tracks = Tracks(aligned_);
    HeldBackKeypoints none;
    for (const ScanImage& image : features_.images) none.emplace_back(image.keypoints.size(), false);
    Reporter reporter;
    return AdjustByTracks([&](PhotosLookedIn) { return tracks; }, features_, none, {}, {},
                          JointModel::kSharedStations, {}, reporter, &aligned_, &joint);
  }

  double FocalLengthPx(const AlignedScene& aligned) const {
    return FocalLengths(aligned.scene.cameras.front()).x();
  }

  SyntheticTurntable turntable_;
  ScanFeatures features_;
  AlignedScene aligned_;
};

TEST_F(FocalMoves, ATenthIsAllowedHoweverWellItSeemsKnown) {
  const PhotoAdjustment result = Adjust(1.08, 0.01);
  EXPECT_TRUE(result.is_taken) << result.finding;
}

TEST_F(FocalMoves, MoreIsNotUnlessItIsKnownNoBetter) {
  constexpr double kFactor = 1.15;
  const double start_px = FocalLengthPx(Start(kFactor));
  const double move = std::log(kFactor);
  const PhotoAdjustment refused = Adjust(kFactor, 0.9 * move * start_px / 3);
  EXPECT_FALSE(refused.is_taken);
  EXPECT_EQ(refused.finding, "patches ask for another focal length");
  EXPECT_EQ(FocalLengthPx(aligned_), start_px);
  const PhotoAdjustment taken = Adjust(kFactor, 1.1 * move * start_px / 3);
  EXPECT_TRUE(taken.is_taken) << taken.finding;
  EXPECT_NEAR(std::log(start_px / FocalLengthPx(aligned_)), move, 0.1 * move);
}

}  // namespace
}  // namespace s2gs
