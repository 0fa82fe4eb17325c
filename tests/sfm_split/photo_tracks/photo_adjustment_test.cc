#include "sfm_split/photo_tracks/photo_adjustment.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <random>
#include <set>
#include <string>
#include <vector>

#include "sfm_split/adjust/track_triangulation.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/joint_system/joint_problem.h"
#include "sfm_split/relocalise/scan_refinement.h"
#include "sfm_split/scene/pose_error.h"
#include "sfm_split/scene/projection_jacobians.h"
#include "tests/support/synthetic_grey_photos.h"
#include "tests/support/synthetic_models.h"
#include "tests/support/synthetic_scan.h"

namespace s2gs {
namespace {

SyntheticTurntableOptions SmallScan() {
  SyntheticTurntableOptions options;
  options.stations = 2;
  options.steps = 12;
  options.step_deg = 30;
  options.num_object_points = 400;
  options.num_platter_points = 100;
  options.num_background_points = 300;
  options.max_view_change_deg = 70;
  options.width = 320;
  options.height = 240;
  options.focal_widths = 1.6;
  options.pixel_noise = 0.4;
  return options;
}

// A scan of photos and keypoints of one scene, placed by its keypoints.
struct Scan {
  SyntheticTurntable turntable = MakeSyntheticTurntable(SmallScan());
  ScanFeatures features = SyntheticScanFeatures(turntable);
  std::map<std::string, GreyPhoto> photos = RenderGreyPhotos(turntable);
  AlignedScene aligned;
  RefineReport refined;

  Scan() {
    const ColmapModel object = SyntheticObjectModel(turntable);
    const ColmapModel background = SyntheticStaticModel(turntable);
    aligned = AlignScene(object, &background, StationsOf(features));
    Reporter reporter;
    refined = RefineScan(features, &object, {}, {}, reporter, &aligned);
  }

  PhotoAdjustment Adjust(const ReadGreyPhoto& read, AlignedScene* scene, JointReport* joint) const {
    Reporter reporter;
    return AdjustByPhotos(read, features, refined.held_back, refined.priors, {}, {refined.model, {}}, {},
                          reporter, scene, joint);
  }

  // The largest rotation error and that of the cameras' centres in metres, medians.
  Eigen::Vector2d ErrorsOf(const AlignedScene& scene) const {
    PoseMap estimate;
    PoseMap truth;
    for (const View& view : turntable.scene.views) truth[view.name] = view.CamFromObject();
    for (const View& view : scene.scene.views) estimate[view.name] = view.CamFromObject();
    const PoseErrors errors = ComparePoses(estimate, truth);
    return {UpperMedian(errors.rotation_deg), UpperMedian(errors.centre_length)};
  }
};

const Scan& TheScan() {
  static const Scan scan;
  return scan;
}

void ExpectUntouched(const AlignedScene& before, const AlignedScene& after) {
  ASSERT_EQ(before.scene.views.size(), after.scene.views.size());
  for (size_t v = 0; v < before.scene.views.size(); ++v) {
    EXPECT_EQ(before.scene.views[v].CamFromObject().Matrix(), after.scene.views[v].CamFromObject().Matrix());
  }
  ASSERT_EQ(before.object.points3D.size(), after.object.points3D.size());
  for (const auto& [id, point] : before.object.points3D)
    EXPECT_EQ(point.xyz, after.object.points3D.at(id).xyz);
}

TEST(PhotoAdjustment, PosesComeNearerToTheTruth) {
  const Scan& scan = TheScan();
  AlignedScene scene = scan.aligned;
  JointReport joint = scan.refined.joint;
  const PhotoAdjustment result =
      scan.Adjust([&](const std::string& name) { return scan.photos.at(name); }, &scene, &joint);
  EXPECT_TRUE(result.is_taken) << result.finding;
  EXPECT_EQ(result.reason, PhotoReason::kHeldBackPatches);
  EXPECT_EQ(result.looked_in, PhotosLookedIn::kFacing);
  EXPECT_EQ(result.facing_finding, "");
  EXPECT_LT(result.log_sigma_change, 0);
  EXPECT_EQ(result.tied_stations, (std::set<int>{0, 1}));
  EXPECT_GT(result.patches.gain, 3.4 * result.patches.gain_sigma);
  EXPECT_LT(joint.sigma_px, 0.5 * scan.refined.joint.sigma_px);
  const Eigen::Vector2d before = scan.ErrorsOf(scan.aligned);
  const Eigen::Vector2d after = scan.ErrorsOf(scene);
  EXPECT_LT(after.x(), 0.5 * before.x());  // .0149 to .0050 degrees
  EXPECT_LT(after.y(), 0.7 * before.y());  // .083 to .044 mm
  // Models and scene say the same.
  for (const View& view : scene.scene.views) {
    const auto image = std::find_if(scene.object.images.begin(), scene.object.images.end(),
                                    [&](const auto& entry) { return entry.second.name == view.name; });
    EXPECT_LT((image->second.cam_from_world.Matrix() - view.CamFromObject().Matrix()).norm(), 1e-9);
  }
}

// Points that the model does not have tell poses as well, and stay out of it.
TEST(PhotoAdjustment, PointsThatNoKeypointSeesTellPoses) {
  const Scan& scan = TheScan();
  AlignedScene scene = scan.aligned;
  JointReport joint = scan.refined.joint;
  Reporter reporter;
  const uint64_t next_id = scene.object.points3D.rbegin()->first + 1;
  const auto find = [&](PhotosLookedIn where) {
    TrackPlacesOptions places;
    if (where == PhotosLookedIn::kTracks) places.min_facing = 1;
    std::vector<SurfacePoint> points;
    for (const auto& [id, point] : scan.aligned.object.points3D) {
      if (point.track.size() < 3) continue;
      SurfacePoint surface;
      surface.patch.centre = point.xyz;
      for (const ColmapTrackElement& element : point.track) surface.image_ids.push_back(element.image_id);
      const ColmapImage& first = scan.aligned.object.images.at(surface.image_ids.front());
      surface.patch.normal = (CameraCentre(first.cam_from_world) - point.xyz).normalized();
      points.push_back(surface);
    }
    const std::vector<AlignedTrack> tracks = AlignPoints(
        scan.aligned.object, points, [&](const std::string& name) { return scan.photos.at(name); }, places,
        reporter);
    for (const AlignedTrack& track : tracks) {
      EXPECT_GE(track.point3D_id, next_id);
      for (const TrackPlace& place : track.places) EXPECT_EQ(place.point2D_idx, kNoKeypoint);
    }
    return tracks;
  };
  const PhotoAdjustment result =
      AdjustByTracks(find, scan.features, scan.refined.held_back, scan.refined.priors, {},
                     {scan.refined.model, {}}, {}, reporter, &scene, &joint);
  EXPECT_TRUE(result.is_taken) << result.finding;
  EXPECT_GT(result.tracks, 50);
  EXPECT_LT(joint.sigma_px, 0.5 * scan.refined.joint.sigma_px);
  EXPECT_LT(scan.ErrorsOf(scene).x(), 0.9 * scan.ErrorsOf(scan.aligned).x());  // .0149 to .0119 degrees
  for (const auto& [id, point] : scene.object.points3D) EXPECT_LT(id, next_id);
  EXPECT_GT(scene.object.points3D.size(), scan.aligned.object.points3D.size() / 2);
}

// Each process of a test renders the photos, so that cases share one: photos of something else; photos that
// cannot be read; photos that were moved after their features were found, of which patches agree with each
// other, but not with keypoints that were held back.
TEST(PhotoAdjustment, OtherPhotosChangeNothing) {
  const Scan& scan = TheScan();
  const auto number = [](const std::string& name) { return name[name.size() - 5] - '0'; };
  const ReadGreyPhoto other = [&](const std::string& name) {
    GreyPhoto photo = scan.photos.at(name);
    for (size_t i = 0; i < photo.grey.size(); ++i)
      photo.grey[i] = static_cast<uint8_t>(i * i * static_cast<size_t>(37 * number(name) + 11) % 251);
    return photo;
  };
  const ReadGreyPhoto none = [](const std::string&) { return GreyPhoto(); };
  const ReadGreyPhoto moved = [&](const std::string& name) {
    GreyPhoto photo = scan.photos.at(name);
    if (number(name) % 3 != 0) std::rotate(photo.grey.begin(), photo.grey.begin() + 1, photo.grey.end());
    return photo;
  };
  for (const ReadGreyPhoto& read : {other, none, moved}) {
    AlignedScene scene = scan.aligned;
    JointReport joint = scan.refined.joint;
    const PhotoAdjustment result = scan.Adjust(read, &scene, &joint);
    EXPECT_FALSE(result.is_taken) << result.finding;
    EXPECT_EQ(result.reason, PhotoReason::kNone);
    EXPECT_TRUE(result.tied_stations.empty());
    ExpectUntouched(scan.aligned, scene);
    EXPECT_EQ(joint.sigma_px, scan.refined.joint.sigma_px);
  }
}

// To three photos at most.
void ShortenTracks(ColmapModel* model) {
  for (auto& [id, point] : model->points3D) {
    while (point.track.size() > 3) {
      const ColmapTrackElement& last = point.track.back();
      model->images.at(last.image_id).points2D[last.point2D_idx].point3D_id = kInvalidPoint3DId;
      point.track.pop_back();
    }
  }
}

// Tracks of three photos, as descriptors follow an object with little texture.
TEST(PhotoAdjustment, PhotosThatPointsFaceTellMoreThanTracksAlone) {
  const Scan& scan = TheScan();
  const auto adjust = [&](double min_facing, AlignedScene* scene, JointReport* joint) {
    PhotoAdjustmentOptions options;
    options.places.min_facing = min_facing;
    Reporter reporter;
    *scene = scan.aligned;
    ShortenTracks(&scene->object);
    *joint = scan.refined.joint;
    return AdjustByPhotos([&](const std::string& name) { return scan.photos.at(name); }, scan.features,
                          scan.refined.held_back, scan.refined.priors, {}, {scan.refined.model, {}}, options,
                          reporter, scene, joint);
  };
  AlignedScene by_tracks;
  AlignedScene by_all;
  JointReport of_tracks;
  JointReport of_all;
  const PhotoAdjustment tracks = adjust(1, &by_tracks, &of_tracks);
  const PhotoAdjustment all = adjust(0.5, &by_all, &of_all);
  EXPECT_EQ(tracks.places_beside, 0);
  EXPECT_TRUE(all.is_taken) << all.finding;
  EXPECT_GT(all.places_beside, all.places / 2);
  EXPECT_LT(of_all.focal_sigma_px[0], 0.7 * scan.refined.joint.focal_sigma_px[0]);
  EXPECT_LT(of_all.axis_direction_sigma_deg, of_tracks.axis_direction_sigma_deg);
  EXPECT_LT(scan.ErrorsOf(by_all).x(), 0.7 * scan.ErrorsOf(by_tracks).x());
  // Models keep the tracks of their keypoints.
  for (const auto& [id, point] : by_all.object.points3D) EXPECT_LE(point.track.size(), 3U);
}

// Every fourth photo shows the object a pixel higher, as one that bends might, and no track of three photos
// has a keypoint in it: what patches say all around is contradictory then, and tracks' own photos are what is
// left.
TEST(PhotoAdjustment, WhatBendsLeavesThePhotosOfTheTracks) {
  const Scan& scan = TheScan();
  std::map<std::string, int> number;
  for (const View& view : scan.aligned.scene.views)
    number.emplace(view.name, static_cast<int>(number.size()));
  const auto is_bent = [&](const std::string& name) { return number.at(name) % 4 == 3; };
  AlignedScene scene = scan.aligned;
  for (auto& [id, point] : scene.object.points3D) {
    // Those of two photos keep the bent ones where they are.
    const bool is_short = id % 2 == 0;
    std::vector<ColmapTrackElement> kept;
    for (const bool wants_bent : {true, false}) {
      for (const ColmapTrackElement& element : point.track) {
        ColmapImage& image = scene.object.images.at(element.image_id);
        if (is_bent(image.name) != wants_bent) continue;
        if (is_short ? kept.size() < 2 : !wants_bent) {
          kept.push_back(element);
        } else {
          image.points2D[element.point2D_idx].point3D_id = kInvalidPoint3DId;
        }
      }
    }
    point.track = std::move(kept);
  }
  // Poses that patches can mend: each angle is off by half a degree.
  JointProblem turned = MakeJointProblem(scene);
  for (size_t i = 0; i < turned.images.size(); ++i) {
    if (static_cast<int>(i) != turned.reference)
      turned.images[i].angle_rad += (i % 2 == 0 ? 0.5 : -0.5) * kDegree;
  }
  ApplyJointProblem(turned, &scene);
  const double before = scan.ErrorsOf(scene).x();
  JointReport joint = scan.refined.joint;
  const ReadGreyPhoto bent = [&](const std::string& name) {
    GreyPhoto photo = scan.photos.at(name);
    if (is_bent(name)) std::rotate(photo.grey.begin(), photo.grey.begin() + photo.width, photo.grey.end());
    return photo;
  };
  Reporter reporter;
  const PhotoAdjustment result =
      AdjustByPhotos(bent, scan.features, scan.refined.held_back, scan.refined.priors, {},
                     {scan.refined.model, {}}, {}, reporter, &scene, &joint);
  EXPECT_TRUE(result.is_taken) << result.finding << "; " << result.facing_finding;
  EXPECT_EQ(result.looked_in, PhotosLookedIn::kTracks);
  EXPECT_EQ(result.reason, PhotoReason::kHeldBackPatches);
  EXPECT_EQ(result.places_beside, 0);
  EXPECT_NE(result.facing_finding, "");
  EXPECT_NE(result.finding.find("in photos of their tracks"), std::string::npos) << result.finding;
  EXPECT_LT(scan.ErrorsOf(scene).x(), 0.05 * before);  // .481 to .0077 degrees
}

// A photo in which no patch is found keeps its keypoints, and its angle with them.
TEST(PhotoAdjustment, APhotoWithoutPatchesKeepsItsKeypoints) {
  const Scan& scan = TheScan();
  const std::string blank = scan.aligned.scene.views[5].name;
  AlignedScene scene = scan.aligned;
  JointReport joint = scan.refined.joint;
  const PhotoAdjustment result = scan.Adjust(
      [&](const std::string& name) {
        GreyPhoto photo = scan.photos.at(name);
        if (name == blank) std::fill(photo.grey.begin(), photo.grey.end(), uint8_t{128});
        return photo;
      },
      &scene, &joint);
  EXPECT_TRUE(result.is_taken) << result.finding;
  EXPECT_GT(joint.angle_sigma_deg[5], 0);
  EXPECT_LT(joint.angle_sigma_deg[5], 0.1);
}

// .03 px measured.
TEST(TrackPlaces, AreThoseOfOnePointByExactPoses) {
  const Scan& scan = TheScan();
  const ColmapModel model = SyntheticObjectModel(scan.turntable);
  Reporter reporter;
  const std::vector<AlignedTrack> tracks = AlignTracks(
      model, [&](const std::string& name) { return scan.photos.at(name); }, {}, reporter);
  EXPECT_GT(tracks.size(), 200U);
  std::vector<double> errors;
  for (const AlignedTrack& track : tracks) {
    std::vector<PosedImage> images;
    std::vector<Keypoints> keypoints;
    std::vector<TrackElement> elements;
    for (const TrackPlace& place : track.places) {
      const ColmapImage& image = model.images.at(place.image_id);
      elements.push_back({static_cast<int>(images.size()), 0});
      images.push_back({true, &model.cameras.at(image.camera_id), image.cam_from_world});
      keypoints.push_back({place.place.xy.cast<float>()});
    }
    Eigen::Vector3d x = model.points3D.at(track.point3D_id).xyz;
    ASSERT_TRUE(RefinePoint(images, keypoints, elements, &x));
    for (size_t k = 0; k < images.size(); ++k)
      errors.push_back(ReprojectionErrorPx(images[k], x, keypoints[k][0].cast<double>()));
  }
  EXPECT_LT(UpperMedian(errors), 0.06);
}

// Places in photos beside a track are of its point, or not found: what hides it is not taken for it.
TEST(TrackPlaces, PhotosBesideATrackShowItsPoint) {
  const Scan& scan = TheScan();
  ColmapModel model = SyntheticObjectModel(scan.turntable);
  ShortenTracks(&model);
  Reporter reporter;
  const ReadGreyPhoto read = [&](const std::string& name) { return scan.photos.at(name); };
  TrackPlacesOptions alone;
  alone.min_facing = 1;
  TrackPlacesOptions none_beside;
  none_beside.max_beside = 0;
  for (const TrackPlacesOptions& options : {alone, none_beside}) {
    for (const AlignedTrack& track : AlignTracks(model, read, options, reporter)) {
      for (const TrackPlace& place : track.places) EXPECT_NE(place.point2D_idx, kNoKeypoint);
    }
  }
  std::vector<double> errors;
  for (const AlignedTrack& track : AlignTracks(model, read, {}, reporter)) {
    const Eigen::Vector3d& x = model.points3D.at(track.point3D_id).xyz;
    Eigen::Vector2d of_track = Eigen::Vector2d::Zero();
    int count = 0;
    const auto error = [&](const TrackPlace& place) -> Eigen::Vector2d {
      const ColmapImage& image = model.images.at(place.image_id);
      const Camera& camera = model.cameras.at(image.camera_id);
      Eigen::Vector2d predicted;
      EXPECT_TRUE(ProjectWithJacobians(camera.model, camera.params.data(), image.cam_from_world * x,
                                       &predicted, nullptr, nullptr));
      return place.place.xy - predicted;
    };
    for (const TrackPlace& place : track.places) {
      if (place.point2D_idx == kNoKeypoint) continue;
      of_track += error(place);
      ++count;
    }
    if (count == 0) continue;
    for (const TrackPlace& place : track.places) {
      if (place.point2D_idx == kNoKeypoint) errors.push_back((error(place) - of_track / count).norm());
    }
  }
  EXPECT_GT(errors.size(), 500U);
  EXPECT_LT(Quantile(errors, 0.5), 0.1);
  EXPECT_LT(Quantile(errors, 0.95), 0.5);
}

// Links that are errors of .2 px, some of them wrong, and places anywhere within 2 px.
TEST(LogRatioOfLinks, TellsErrorsFromPlacesAnywhere) {
  std::mt19937 random(4);
  std::normal_distribution<double> normal(0, 0.2);
  std::uniform_real_distribution<double> share(0, 1);
  const auto anywhere = [&] { return 2 * std::sqrt(share(random)); };
  std::vector<double> right;
  for (int k = 0; k < 40; ++k)
    right.push_back(k % 5 == 0 ? anywhere() : std::hypot(normal(random), normal(random)));
  EXPECT_GT(LogRatioOfLinks(right, 2), 8 * 4);
  int above = 0;
  for (int trial = 0; trial < 1000; ++trial) {
    std::vector<double> wrong;
    for (int k = 0; k < 4 + trial % 40; ++k) wrong.push_back(anywhere());
    above += LogRatioOfLinks(wrong, 2) > 8 ? 1 : 0;
  }
  EXPECT_EQ(above, 0);
  EXPECT_EQ(LogRatioOfLinks({}, 2), 0);
}

TEST(HeldBackChange, ChanceIsNoChange) {
  EXPECT_FALSE(HeldBackChange().HasFallen());
  EXPECT_TRUE((HeldBackChange{100, 1, 0.5, 0.35, 0.1}).HasFallen());
  EXPECT_FALSE((HeldBackChange{100, 1, 0.5, 0.3, 0.1}).HasFallen());
  EXPECT_TRUE((HeldBackChange{100, 1, 0.5, 0.3, 0.1}).HasFallen(2.9));
  EXPECT_TRUE((HeldBackChange{100, 1, 0.5, 0.7, 0.1, 2}).HasFallen());
  EXPECT_FALSE((HeldBackChange{100, 1, 0.5, 0.67, 0.1, 2}).HasFallen());
  EXPECT_FALSE(HeldBackChange().HasRisen());
  EXPECT_TRUE((HeldBackChange{100, 0.5, 1, -0.35, 0.1}).HasRisen());
  EXPECT_FALSE((HeldBackChange{100, 0.5, 1, -0.35, 0.1, 2}).HasRisen());
}

}  // namespace
}  // namespace s2gs
