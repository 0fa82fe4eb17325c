#include "plugin/outputs/steady_photo.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "sfm_split/base/angles.h"

namespace s2gs {
namespace {

constexpr int kWidth = 96;
constexpr int kHeight = 72;

// A pattern that is smooth on the scale of a pixel; x and y as COLMAP counts them.
double Pattern(double x, double y) { return 128 + 60 * std::sin(0.31 * x + 0.2) * std::cos(0.23 * y - 0.4); }

TEST(SteadyPhoto, ShowsWhatTheFirstPhotoShows) {
  Camera camera;
  camera.camera_id = 1;
  camera.model = CameraModelId::kSimplePinhole;
  camera.width = kWidth;
  camera.height = kHeight;
  camera.params = {90, 48, 36};
  const Eigen::Quaterniond turn(
      Eigen::AngleAxisd(1.5 * kDegree, Eigen::Vector3d(0.4, -0.8, 0.3).normalized()));
  Eigen::Matrix3d K;
  K << 90, 0, 48, 0, 90, 36, 0, 0, 1;
  ScanFeatures features;
  features.cameras[1] = camera;
  features.images.resize(2);
  features.images[0].name = "still.jpg";
  features.images[1].name = "turned.jpg";
  features.images[1].photo_from_first = K * turn.toRotationMatrix() * K.inverse();
  for (ScanImage& image : features.images) image.camera_id = 1;
  const SteadyCameras cameras(features, {});

  GreyPhoto turned{kWidth, kHeight, {}};
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const Eigen::Vector2d first =
          (features.images[1].photo_from_first.inverse() * Eigen::Vector3d(x + 0.5, y + 0.5, 1))
              .hnormalized();
      turned.grey.push_back(static_cast<uint8_t>(std::lround(Pattern(first.x(), first.y()))));
    }
  }
  const GreyPhoto steady = SteadyPhoto(turned, "turned.jpg", cameras);
  ASSERT_EQ(steady.grey.size(), turned.grey.size());
  double largest = 0;
  double unmoved = 0;
  for (int y = 8; y < kHeight - 8; ++y) {
    for (int x = 8; x < kWidth - 8; ++x) {
      const double expected = Pattern(x + 0.5, y + 0.5);
      largest = std::max(largest, std::abs(steady.grey[static_cast<size_t>(y) * kWidth + x] - expected));
      unmoved = std::max(unmoved, std::abs(turned.grey[static_cast<size_t>(y) * kWidth + x] - expected));
    }
  }
  EXPECT_LT(largest, 2.5);  // two roundings; half a pixel aside would be 9
  EXPECT_GT(unmoved, 20);
  EXPECT_EQ(SteadyPhoto(turned, "still.jpg", cameras).grey, turned.grey);
  EXPECT_TRUE(SteadyPhoto({}, "turned.jpg", cameras).grey.empty());
}

}  // namespace
}  // namespace s2gs
