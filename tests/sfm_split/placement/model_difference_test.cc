#include "sfm_split/placement/model_difference.h"

#include <gtest/gtest.h>

#include <cmath>
#include <string>

#include "sfm_split/base/infinity.h"

namespace s2gs {
namespace {

// Four photos at two stations, and a lens.
TurntableScene MakeScene() {
  TurntableScene scene;
  Camera camera;
  camera.camera_id = 1;
  camera.model = CameraModelId::kSimplePinhole;
  camera.params = {500, 320, 240};
  scene.cameras = {camera};
  for (int k = 0; k < 4; ++k) {
    View view;
    view.name = "photo" + std::to_string(k);
    view.station = k / 2;
    view.angle_deg = 170 + 15 * k;
    scene.views.push_back(view);
  }
  scene.reference = "photo0";
  return scene;
}

TEST(ModelDifference, AnglesAndLensesWidenByWhatTheModelsDifferIn) {
  const TurntableScene of_stations = MakeScene();
  TurntableScene of_photos = of_stations;
  // All photos turned by one angle differ in nothing; angles wrap.
  for (View& view : of_photos.views) view.angle_deg -= 359;
  of_photos.views[2].angle_deg += 0.3;
  of_photos.views[3].angle_deg += 0.4;
  of_photos.cameras[0].params[0] = 503;
  JointReport joint;
  joint.angle_sigma_deg = {0, 0.1, 0.4, 0.3};
  joint.focal_sigma_px = {4};
  WidenByDifference(of_photos, of_stations, &joint);
  EXPECT_EQ(joint.angle_sigma_deg[0], 0);
  EXPECT_NEAR(joint.angle_sigma_deg[1], 0.1, 1e-9);
  EXPECT_NEAR(joint.angle_sigma_deg[2], 0.5, 1e-9);
  EXPECT_NEAR(joint.angle_sigma_deg[3], 0.5, 1e-9);
  EXPECT_NEAR(joint.focal_sigma_px[0], 5, 1e-9);
}

TEST(ModelDifference, WhatIsNotKnownStays) {
  const TurntableScene of_stations = MakeScene();
  TurntableScene of_photos = of_stations;
  of_photos.views[2].angle_deg += 1;
  of_photos.views.pop_back();
  JointReport joint;
  joint.angle_sigma_deg = {0, -1, kInfinity, 0.3};
  joint.focal_sigma_px = {0};
  WidenByDifference(of_photos, of_stations, &joint);
  EXPECT_EQ(joint.angle_sigma_deg[0], 0);
  EXPECT_EQ(joint.angle_sigma_deg[1], -1);
  EXPECT_EQ(joint.angle_sigma_deg[2], kInfinity);
  EXPECT_EQ(joint.angle_sigma_deg[3], 0.3);
  EXPECT_EQ(joint.focal_sigma_px[0], 0);
}

}  // namespace
}  // namespace s2gs
