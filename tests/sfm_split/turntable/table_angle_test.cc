#include "sfm_split/turntable/table_angle.h"

#include <gtest/gtest.h>

#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "tests/sfm_split/relocalise/small_scan.h"
#include "tests/support/synthetic_scan.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

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

}  // namespace
}  // namespace s2gs
