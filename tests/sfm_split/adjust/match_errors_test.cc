#include "sfm_split/adjust/match_errors.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <vector>

#include "tests/sfm_split/relocalise/small_scan.h"
#include "tests/support/synthetic_scan.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

std::vector<const Keypoints*> PointersTo(const std::vector<Keypoints>& keypoints) {
  std::vector<const Keypoints*> pointers;
  for (const Keypoints& of_image : keypoints) pointers.push_back(&of_image);
  return pointers;
}

// Sampson's error by the fundamental matrix of pinholes, in pixels.
double ByFundamentalMatrix(const PosedImage& one, const PosedImage& two, const Eigen::Vector2f& xy1,
                           const Eigen::Vector2f& xy2) {
  const Rigid3 pose = two.cam_from_body * one.cam_from_body.Inverse();
  const Vector3d& t = pose.translation;
  Matrix3d cross;
  cross << 0, -t.z(), t.y(), t.z(), 0, -t.x(), -t.y(), t.x(), 0;
  const auto inverse_k = [](const Camera& camera) {
    const std::vector<double>& p = camera.params;
    Matrix3d k;
    k << p[0], 0, p[1], 0, p[0], p[2], 0, 0, 1;
    return Matrix3d(k.inverse());
  };
  const Matrix3d f =
      inverse_k(*two.camera).transpose() * cross * pose.rotation.toRotationMatrix() * inverse_k(*one.camera);
  const Vector3d x1 = xy1.cast<double>().homogeneous();
  const Vector3d x2 = xy2.cast<double>().homogeneous();
  const Vector3d line2 = f * x1;
  const Vector3d line1 = f.transpose() * x2;
  return std::abs(x2.dot(line2)) / std::sqrt(line2.head<2>().squaredNorm() + line1.head<2>().squaredNorm());
}

TEST(MatchErrors, AreThoseOfTheFundamentalMatrix) {
  SyntheticTurntableOptions options = SmallScan();
  options.outlier_share = 0.3;
  options.pixel_noise = 0.5;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  const std::vector<Keypoints> keypoints = KeypointsOf(features);
  std::vector<PosedImage> posed = TruePosesOfObject(turntable);
  Camera pinhole;
  pinhole.model = CameraModelId::kSimplePinhole;
  pinhole.width = posed[0].camera->width;
  pinhole.height = posed[0].camera->height;
  pinhole.params = {700, 310, 330};
  for (PosedImage& image : posed) image.camera = &pinhole;
  posed[3].is_posed = false;
  const MatchErrors against(posed, PointersTo(keypoints));
  // The second time rays are known.
  for (int round = 0; round < 2; ++round) {
    const std::vector<std::vector<double>> errors = against.Of(features.object_pairs);
    ASSERT_EQ(errors.size(), features.object_pairs.size());
    size_t asked = 0, unposed = 0;
    for (size_t p = 0; p < errors.size(); ++p) {
      const ImagePairMatches& pair = features.object_pairs[p];
      if (pair.image1 == 3 || pair.image2 == 3) {
        EXPECT_TRUE(errors[p].empty());
        ++unposed;
        continue;
      }
      ASSERT_EQ(errors[p].size(), pair.matches.size());
      EXPECT_EQ(against.Of(pair.image1, pair.image2, pair.matches), errors[p]);
      for (size_t m = 0; m < pair.matches.size(); ++m) {
        const auto i = static_cast<size_t>(pair.image1);
        const auto j = static_cast<size_t>(pair.image2);
        const double expected =
            ByFundamentalMatrix(posed[i], posed[j], keypoints[i][pair.matches[m].point2D_idx1],
                                keypoints[j][pair.matches[m].point2D_idx2]);
        EXPECT_NEAR(errors[p][m], expected, 1e-9 * (1 + expected));
        ++asked;
      }
    }
    EXPECT_GT(asked, 1000U);
    EXPECT_GT(unposed, 0U);
  }
}

// Beyond where a lens turns back there is no ray.
TEST(MatchErrors, AreInfiniteWhereAPixelHasNoRay) {
  Camera camera;
  camera.model = CameraModelId::kSimpleRadial;
  camera.width = camera.height = 640;
  camera.params = {300, 320, 320, -0.5};
  const std::vector<PosedImage> posed = {{true, &camera, {Eigen::Quaterniond::Identity(), {0, 0, 2}}},
                                         {true, &camera, {Eigen::Quaterniond::Identity(), {0.5, 0, 2}}}};
  const std::vector<Keypoints> keypoints = {{{1, 1}, {320, 310}}, {{350, 310}, {639, 639}}};
  const MatchErrors against(posed, PointersTo(keypoints));
  for (int round = 0; round < 2; ++round) {
    const std::vector<double> errors = against.Of(0, 1, {{0, 0}, {1, 1}, {1, 0}});
    ASSERT_EQ(errors.size(), 3U);
    EXPECT_TRUE(std::isinf(errors[0]));
    EXPECT_TRUE(std::isinf(errors[1]));
    EXPECT_LT(errors[2], 1);
  }
}

}  // namespace
}  // namespace s2gs
