#include "tests/support/synthetic_turntable.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <set>

#include "sfm_split/base/angles.h"
#include "sfm_split/scene/camera_model.h"
#include "tests/support/small_turntable.h"

namespace s2gs {
namespace {

Eigen::Vector3d InCamera(const SyntheticTurntable& turntable, int image, const SyntheticKeypoint& keypoint) {
  return turntable.CamFromBody(image, keypoint.body) *
         turntable.points[static_cast<size_t>(keypoint.point)].x;
}

TEST(SyntheticTurntable, PinholeKeypointsFollowTheFormula) {
  SyntheticTurntableOptions options = SmallTurntable();
  options.principal_point_offset = {0.03, -0.02};
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  int checked = 0;
  for (int image = 0; image < 12; ++image) {
    for (const SyntheticKeypoint& keypoint : turntable.images[static_cast<size_t>(image)].keypoints) {
      const Eigen::Vector3d x = InCamera(turntable, image, keypoint);
      EXPECT_NEAR(keypoint.xy.x(), 1.2 * 640 * x.x() / x.z() + 320 + 0.03 * 640, 1e-9);
      EXPECT_NEAR(keypoint.xy.y(), 1.2 * 640 * x.y() / x.z() + 240 - 0.02 * 640, 1e-9);
      ++checked;
    }
  }
  EXPECT_GT(checked, 2000);
}

TEST(SyntheticTurntable, DistortedKeypointsFollowTheFormula) {
  SyntheticTurntableOptions options = SmallTurntable();
  options.camera_model = CameraModelId::kOpenCV;
  options.distortion = {-0.12, 0.03, 0.001, -0.002};
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  for (int image = 0; image < 12; ++image) {
    for (const SyntheticKeypoint& keypoint : turntable.images[static_cast<size_t>(image)].keypoints) {
      const Eigen::Vector3d x_in_cam = InCamera(turntable, image, keypoint);
      const double x = x_in_cam.x() / x_in_cam.z();
      const double y = x_in_cam.y() / x_in_cam.z();
      const double r2 = x * x + y * y;
      const double radial = 1 - 0.12 * r2 + 0.03 * r2 * r2;
      const double xd = x * radial + 2 * 0.001 * x * y - 0.002 * (r2 + 2 * x * x);
      const double yd = y * radial + 0.001 * (r2 + 2 * y * y) - 2 * 0.002 * x * y;
      EXPECT_NEAR(keypoint.xy.x(), 768 * xd + 320, 1e-9);
      EXPECT_NEAR(keypoint.xy.y(), 768 * yd + 240, 1e-9);
    }
  }
}

TEST(SyntheticTurntable, EveryProjectableCameraModelSeesTheScene) {
  for (int id = 0; id < 32; ++id) {
    const CameraModelInfo* info = FindCameraModel(id);
    if (info == nullptr || !info->has_projection) continue;
    SyntheticTurntableOptions options = SmallTurntable();
    options.camera_model = info->id;
    options.distortion.assign(info->num_extra_params, 0.002);
    ASSERT_FALSE(options.Check()) << info->name;
    const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
    for (const SyntheticImage& image : turntable.images)
      EXPECT_GT(image.keypoints.size(), 150U) << info->name;
  }
}

TEST(SyntheticTurntable, PosesComposeAndTurnAboutTheAxis) {
  SyntheticTurntableOptions options = SmallTurntable();
  options.step_jitter = 0.5;
  options.station_start_deg = 7;
  options.table_tilt_deg = 12;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const TurntableScene& scene = turntable.scene;
  ASSERT_EQ(scene.views.size(), 12U);
  EXPECT_TRUE(scene.views[0].world_from_object.Matrix().isIdentity(0));
  EXPECT_EQ(scene.num_stations, 2);
  EXPECT_TRUE(scene.scale_observable);
  for (const View& view : scene.views) {
    EXPECT_TRUE(view.CamFromObject().Matrix().isApprox(
        view.cam_from_world.Matrix() * view.world_from_object.Matrix(), 1e-14));
    const Eigen::Vector3d on_axis = scene.axis.point + 0.3 * scene.axis.direction;
    EXPECT_LT((view.world_from_object * on_axis - on_axis).norm(), 1e-15);
    const Eigen::Vector3d turned = view.world_from_object.rotation * Eigen::Vector3d::UnitX();
    EXPECT_NEAR(turned.x(), std::cos(view.angle_deg * kDegree), 1e-14);
    EXPECT_NEAR(turned.y(), std::sin(view.angle_deg * kDegree), 1e-14);
    const double regular =
        20.0 * turntable.images[static_cast<size_t>(&view - scene.views.data())].step + 7.0 * view.station;
    EXPECT_LE(std::abs(view.angle_deg - regular), 5.0);
  }
  EXPECT_TRUE(std::is_sorted(scene.views.begin(), scene.views.end(),
                             [](const View& a, const View& b) { return a.name < b.name; }));
  double mean_z = 0;
  for (const SyntheticPoint& point : turntable.points) {
    if (point.body == SyntheticBody::kObject) mean_z += point.x.z() / options.num_object_points;
  }
  EXPECT_NEAR(mean_z, 0, 1e-15);
  // The platter is level in the world, the floor (the walls' box) is tilted.
  EXPECT_TRUE(turntable.platter.frame_from_shape.rotation.isApprox(Eigen::Quaterniond::Identity()));
  const Eigen::Vector3d up = turntable.room[0].frame_from_shape.rotation * Eigen::Vector3d::UnitZ();
  EXPECT_NEAR(std::acos(up.z()), 12 * kDegree, 1e-12);
}

TEST(SyntheticTurntable, StationsStandStillUpToShake) {
  SyntheticTurntableOptions options = SmallTurntable();
  SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const auto& views = turntable.scene.views;
  for (int i = 1; i < 6; ++i) {
    EXPECT_EQ(views[static_cast<size_t>(i)].cam_from_world.Matrix(), views[0].cam_from_world.Matrix());
  }
  EXPECT_GT((CameraCentre(views[6].cam_from_world) - CameraCentre(views[0].cam_from_world)).norm(), 0.2);

  options.steps = 100;
  options.step_deg = 3;
  options.shake_deg = 0.1;
  options.shake_distance = 0.002;
  options.num_object_points = options.num_platter_points = options.num_background_points = 0;
  turntable = MakeSyntheticTurntable(options);
  Eigen::Matrix<double, 3, Eigen::Dynamic> translations(3, 100);
  for (int i = 0; i < 100; ++i) {
    translations.col(i) = turntable.scene.views[static_cast<size_t>(i)].cam_from_world.translation;
  }
  const double rotation_deg = turntable.scene.views[0].cam_from_world.rotation.angularDistance(
                                  turntable.scene.views[1].cam_from_world.rotation) /
                              kDegree;
  EXPECT_GT(rotation_deg, 0.001);
  EXPECT_LT(rotation_deg, 1);
  // 200 degrees of freedom: the standard deviation is known to 5 %, four times that is allowed. z is left
  // out: of a camera 0.7 in front of its target the rotation moves x and y, by 0.7 * 0.1 degrees.
  const Eigen::Vector3d mean = translations.rowwise().mean();
  const double z_deviation = std::sqrt((translations.row(2).array() - mean.z()).square().mean());
  EXPECT_NEAR(z_deviation, 0.002, 0.3 * 0.002);
}

TEST(SyntheticTurntable, HandHeldImagesHavePosesOfTheirOwn) {
  SyntheticTurntableOptions options = SmallTurntable();
  options.hand_held = true;
  options.steps = 8;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  ASSERT_EQ(turntable.scene.views.size(), 8U);
  EXPECT_EQ(turntable.scene.num_stations, 8);
  for (size_t i = 1; i < 8; ++i) {
    const View& view = turntable.scene.views[i];
    EXPECT_EQ(view.station, static_cast<int>(i));
    EXPECT_NEAR(view.angle_deg, 20.0 * static_cast<double>(i), 1e-12);
    EXPECT_GT((CameraCentre(view.cam_from_world) - CameraCentre(turntable.scene.views[i - 1].cam_from_world))
                  .norm(),
              0.005);
  }
}

TEST(SyntheticTurntable, NumbersOfPointsAreAsAsked) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(SmallTurntable());
  const auto count = [&](SyntheticBody body) {
    return std::count_if(turntable.points.begin(), turntable.points.end(),
                         [body](const SyntheticPoint& point) { return point.body == body; });
  };
  EXPECT_EQ(count(SyntheticBody::kObject), 300);
  EXPECT_EQ(count(SyntheticBody::kPlatter), 80);
  EXPECT_EQ(count(SyntheticBody::kStatic), 300);
  EXPECT_EQ(turntable.pairs.size(), 66U);  // all of 12
}

TEST(SyntheticTurntable, DropoutAndNoiseHaveTheirStatistics) {
  SyntheticTurntableOptions options = SmallTurntable();
  const SyntheticTurntable full = MakeSyntheticTurntable(options);
  options.dropout = 0.3;
  options.pixel_noise = 0.5;
  options.num_extra_keypoints = 40;
  const SyntheticTurntable noisy = MakeSyntheticTurntable(options);
  double num_full = 0;
  double num_kept = 0;
  double squared = 0;
  for (size_t i = 0; i < full.images.size(); ++i) {
    num_full += static_cast<double>(full.images[i].keypoints.size());
    std::set<int> visible;
    for (const SyntheticKeypoint& keypoint : full.images[i].keypoints) visible.insert(keypoint.point);
    int extra = 0;
    for (const SyntheticKeypoint& keypoint : noisy.images[i].keypoints) {
      if (keypoint.body == SyntheticBody::kNone) {
        ++extra;
        continue;
      }
      ++num_kept;
      squared += (keypoint.xy - keypoint.exact_xy).squaredNorm() / 2;
      EXPECT_EQ(visible.count(keypoint.point), 1U);  // noise makes nothing else visible
    }
    EXPECT_EQ(extra, 40);
  }
  EXPECT_NEAR(num_kept / num_full, 0.7, 4 * std::sqrt(0.3 * 0.7 / num_full) + 0.005);
  EXPECT_NEAR(std::sqrt(squared / num_kept), 0.5, 4 * 0.5 / std::sqrt(4 * num_kept));
}

TEST(SyntheticTurntable, RotatingShareIsMetInEveryImage) {
  for (const double share : {0.08, 0.5, 0.9, 1.0}) {
    SyntheticTurntableOptions options = SmallTurntable();
    options.rotating_share = share;
    const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
    for (const SyntheticImage& image : turntable.images) {
      const auto rotating = std::count_if(image.keypoints.begin(), image.keypoints.end(),
                                          [](const SyntheticKeypoint& k) { return IsRotating(k.body); });
      const double total = static_cast<double>(image.keypoints.size());
      ASSERT_GT(total, 50);
      EXPECT_NEAR(static_cast<double>(rotating), share * total, 0.5 + 1e-9);
    }
  }
}

TEST(SyntheticTurntable, NoBackgroundLeavesOnlyRotatingKeypoints) {
  SyntheticTurntableOptions options = SmallTurntable();
  options.num_background_points = 0;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  for (const SyntheticImage& image : turntable.images) {
    EXPECT_GT(image.keypoints.size(), 50U);
    for (const SyntheticKeypoint& keypoint : image.keypoints) EXPECT_TRUE(IsRotating(keypoint.body));
  }
}

/// Whether a point is inside a shape, by the shape's definition alone.
bool IsInside(const Shape& shape, const Eigen::Vector3d& x_in_frame) {
  const Eigen::Vector3d x = shape.frame_from_shape.Inverse() * x_in_frame;
  switch (shape.kind) {
    case ShapeKind::kBox:
      return (x.cwiseAbs().array() < shape.size.array()).all();
    case ShapeKind::kSphere:
      return x.norm() < shape.size.x();
    case ShapeKind::kCylinder:
      return x.head<2>().norm() < shape.size.x() && std::abs(x.z()) < shape.size.z();
    case ShapeKind::kBumpy:
      return x.norm() < BumpyRadius(shape, x.normalized());
  }
  return false;
}

TEST(SyntheticTurntable, VisibilityIsThatOfTheSolids) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(SmallTurntable());
  int hidden_static = 0;
  int hidden_rotating = 0;
  for (const int image : {0, 4, 9}) {
    const View& view = turntable.scene.views[static_cast<size_t>(image)];
    std::set<int> seen;
    for (const auto& keypoint : turntable.images[static_cast<size_t>(image)].keypoints)
      seen.insert(keypoint.point);
    const Eigen::Vector3d centre = CameraCentre(view.cam_from_world);
    for (size_t i = 0; i < turntable.points.size(); ++i) {
      const SyntheticPoint& point = turntable.points[i];
      const bool rotates = IsRotating(point.body);
      const Eigen::Vector3d x = rotates ? view.world_from_object * point.x : point.x;
      const auto xy = ProjectToImage(turntable.CameraOf(image), view.cam_from_world * x);
      const bool in_image = xy && xy->x() > 0 && xy->y() > 0 && xy->x() < 640 && xy->y() < 480;
      const Eigen::Vector3d normal = rotates ? view.world_from_object.rotation * point.normal : point.normal;
      const double cosine = normal.dot((centre - x).normalized());
      int inside_something = 0;
      constexpr int kSamples = 1500;
      for (int k = 0; k < kSamples; ++k) {
        const Eigen::Vector3d sample = centre + (x - centre) * (k + 0.5) / kSamples;
        const Eigen::Vector3d in_object = view.world_from_object.Inverse() * sample;
        bool inside = IsInside(turntable.object, in_object) || IsInside(turntable.platter, in_object);
        for (size_t s = 1; s < turntable.room.size(); ++s)
          inside = inside || IsInside(turntable.room[s], sample);
        inside_something += inside ? 1 : 0;
      }
      if (seen.count(static_cast<int>(i)) != 0) {
        EXPECT_TRUE(in_image);
        EXPECT_GT(cosine, 0.04);
        EXPECT_EQ(inside_something, 0);
      } else if (in_image && cosine > 0.25) {
        // Whoever faces the camera and is not seen is behind something, if only by a graze of one sample.
        EXPECT_GT(inside_something, 0) << static_cast<int>(point.body) << " " << cosine;
        (rotates ? hidden_rotating : hidden_static) += 1;
      }
    }
  }
  EXPECT_GT(hidden_static, 20);   // the object and the platter hide background
  EXPECT_GT(hidden_rotating, 5);  // the object hides the platter, clutter hides both
}

TEST(SyntheticTurntable, NothingTurnsWhenTheTableStandsStill) {
  SyntheticTurntableOptions options = SmallTurntable();
  options.turning = false;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  for (const View& view : turntable.scene.views) EXPECT_TRUE(view.world_from_object.Matrix().isIdentity(0));
  for (const SyntheticMatch& match : turntable.pairs[0].matches) {
    EXPECT_EQ(turntable.images[0].keypoints[match.keypoint1].xy,
              turntable.images[1].keypoints[match.keypoint2].xy);
  }
}

TEST(SyntheticTurntable, FlippedObjectHasAnAxisOfItsOwn) {
  SyntheticTurntableOptions options = SmallTurntable();
  options.stations = 4;
  options.flip_from_station = 2;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  // In the object's frame the axis is the z axis before the flip, and another line after it: the one that is
  // turned by 180 degrees about x through the object's middle.
  const auto motion_in_object = [&](size_t image1, size_t image2) {
    return turntable.scene.views[image1].world_from_object.Inverse() *
           turntable.scene.views[image2].world_from_object;
  };
  const Eigen::Vector3d middle = turntable.object.frame_from_shape.translation;
  const Eigen::Vector3d before = Eigen::AngleAxisd(motion_in_object(0, 1).rotation).axis();
  const Rigid3 motion_after = motion_in_object(12, 13);
  const Eigen::Vector3d after = Eigen::AngleAxisd(motion_after.rotation).axis();
  EXPECT_TRUE(before.isApprox(Eigen::Vector3d::UnitZ(), 1e-12));
  EXPECT_TRUE(after.isApprox(-Eigen::Vector3d::UnitZ(), 1e-12));
  // World axis point (0, 0, z) in the flipped object's frame: middle + Rx(180) * ((0, 0, z) - middle -
  // offset).
  const Eigen::Vector3d on_axis(middle.x() + (0 - middle.x() + 0.03), middle.y() - (0 - middle.y() - 0.02),
                                0.4);
  EXPECT_LT((motion_after * on_axis - on_axis).norm(), 1e-14);
  // Some points are seen from the bottom only now, and object matches across the flip fit the object's motion
  // while platter matches do not.
  double worst_object = 0;
  double best_platter = 0;
  for (const SyntheticPair& pair : turntable.pairs) {
    if (pair.image1 >= 12 || pair.image2 < 12) continue;
    for (const SyntheticMatch& match : pair.matches) {
      if (match.body == SyntheticBody::kObject) {
        worst_object =
            std::max(worst_object, EpipolarDistance(turntable, pair, match, SyntheticBody::kObject));
      } else if (match.body == SyntheticBody::kPlatter) {
        EXPECT_LT(EpipolarDistance(turntable, pair, match, SyntheticBody::kPlatter), 1e-8);
        best_platter =
            std::max(best_platter, EpipolarDistance(turntable, pair, match, SyntheticBody::kObject));
      }
    }
  }
  EXPECT_GT(worst_object, 0);
  EXPECT_LT(worst_object, 1e-8);
  EXPECT_GT(best_platter, 10);
}

TEST(SyntheticTurntable, PlateIsPlanar) {
  SyntheticTurntableOptions options = SmallTurntable();
  options.object = SyntheticObject::kPlate;
  options.num_platter_points = 0;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  Eigen::MatrixXd centred(300, 3);
  for (int i = 0; i < 300; ++i) centred.row(i) = turntable.points[static_cast<size_t>(i)].x;
  centred.rowwise() -= centred.colwise().mean().eval();
  const Eigen::Vector3d singular = centred.jacobiSvd().singularValues();
  EXPECT_LT(singular[2], 1e-12 * singular[0]);
  EXPECT_GT(singular[1], 0.5 * singular[0]);
  for (const SyntheticImage& image : turntable.images) {
    EXPECT_GT(std::count_if(image.keypoints.begin(), image.keypoints.end(),
                            [](const SyntheticKeypoint& k) { return k.body == SyntheticBody::kObject; }),
              100);
  }
}

TEST(SyntheticTurntable, TextureAndBackgroundCanBePatches) {
  SyntheticTurntableOptions options = SmallTurntable();
  options.object_patch_deg = 40;
  options.background_image_share = 0.25;
  options.stations = 1;
  options.azimuth_spread_deg = 0;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  for (const SyntheticPoint& point : turntable.points) {
    if (point.body != SyntheticBody::kObject) continue;
    const Eigen::Vector3d direction = (point.x - turntable.object.frame_from_shape.translation).normalized();
    EXPECT_GE(-direction.y(), std::cos(40 * kDegree) - 1e-12);
  }
  for (const SyntheticKeypoint& keypoint : turntable.images[3].keypoints) {
    if (keypoint.body != SyntheticBody::kStatic) continue;
    EXPECT_LE(keypoint.xy.x(), 160 + 1e-9);
  }
}

TEST(SyntheticTurntable, SameSeedSameSceneOtherSeedOtherScene) {
  SyntheticTurntableOptions options = SmallTurntable();
  options.pixel_noise = 0.3;
  options.outlier_share = 0.2;
  options.descriptors = true;
  const SyntheticTurntable a = MakeSyntheticTurntable(options);
  const SyntheticTurntable b = MakeSyntheticTurntable(options);
  options.seed = 2;
  const SyntheticTurntable c = MakeSyntheticTurntable(options);
  ASSERT_EQ(a.images[5].keypoints.size(), b.images[5].keypoints.size());
  for (size_t i = 0; i < a.images[5].keypoints.size(); ++i) {
    EXPECT_EQ(a.images[5].keypoints[i].xy, b.images[5].keypoints[i].xy);
  }
  EXPECT_EQ(a.images[5].descriptors, b.images[5].descriptors);
  ASSERT_EQ(a.pairs[9].matches.size(), b.pairs[9].matches.size());
  for (size_t i = 0; i < a.pairs[9].matches.size(); ++i) {
    EXPECT_EQ(a.pairs[9].matches[i].keypoint1, b.pairs[9].matches[i].keypoint1);
    EXPECT_EQ(a.pairs[9].matches[i].keypoint2, b.pairs[9].matches[i].keypoint2);
  }
  EXPECT_NE(a.points[0].x, c.points[0].x);
  EXPECT_NE(a.scene.views[0].cam_from_world.translation, c.scene.views[0].cam_from_world.translation);
}

TEST(SyntheticTurntable, CheckNamesTheFault) {
  EXPECT_FALSE(SyntheticTurntableOptions().Check());
  SyntheticTurntableOptions options;
  options.step_deg = 121;
  ASSERT_TRUE(options.Check());
  EXPECT_EQ(options.Check()->field, "step_deg");
  options = {};
  options.distortion = {0.1};
  EXPECT_EQ(options.Check()->field, "distortion");
  options = {};
  options.pairs = {{0, 72}};
  EXPECT_EQ(options.Check()->field, "pairs");
  options = {};
  options.outlier_share = std::nan("");
  EXPECT_EQ(options.Check()->field, "outlier_share");
}

}  // namespace
}  // namespace s2gs
