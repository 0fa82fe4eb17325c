#include "s2gs/image/undistort.h"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <optional>
#include <thread>

#include "s2gs/image/photos.h"
#include "sfm_split/base/error.h"
#include "tests/support/bad_input.h"

namespace s2gs {
namespace {

Camera Distorted(double k) {
  Camera camera;
  camera.camera_id = 3;
  camera.model = CameraModelId::kSimpleRadial;
  camera.width = 120;
  camera.height = 90;
  camera.params = {100, 61.3, 44.2, k};
  return camera;
}

// A picture that is a smooth function of the ray, through any camera.
Image8 Picture(const Camera& camera) {
  Image8 image = {static_cast<int>(camera.width), static_cast<int>(camera.height), 3, {}};
  image.pixels.resize(static_cast<size_t>(image.width) * image.height * 3);
  for (int y = 0; y < image.height; ++y) {
    for (int x = 0; x < image.width; ++x) {
      const std::optional<Eigen::Vector3d> ray = UnprojectFromImage(camera, {x + 0.5, y + 0.5});
      for (int c = 0; c < 3 && ray; ++c) {
        image.Pixel(x, y)[c] = static_cast<uint8_t>(
            std::lround(127 + 60 * std::sin(5 * ray->x() + c) + 60 * std::cos(4 * ray->y())));
      }
    }
  }
  return image;
}

TEST(Undistort, ResamplesToThePinhole) {
  for (const double k : {-0.15, 0.1}) {
    const Camera camera = Distorted(k);
    const Camera pinhole = UndistortedCamera(camera, "cameras.bin");
    EXPECT_TRUE(IsDistortionFree(pinhole));
    EXPECT_EQ(pinhole.camera_id, 3u);
    EXPECT_EQ(FocalLengths(pinhole), FocalLengths(camera));
    Reporter silent;
    const Image8 image = UndistortImage(Picture(camera), camera, pinhole, silent);
    const Image8 expected = Picture(pinhole);
    ASSERT_EQ(image.pixels.size(), expected.pixels.size());
    double worst = 0;
    for (size_t i = 0; i < image.pixels.size(); ++i) {
      worst = std::max(worst, std::abs(1.0 * image.pixels[i] - expected.pixels[i]));
    }
    EXPECT_LE(worst, 2) << k;  // rounding of source and result; nothing is blank
    // Barrel lenses show more, pincushion lenses less of the plane.
    EXPECT_EQ(pinhole.width > camera.width, k < 0);
  }
}

TEST(Undistort, APhotoOfTwoPixelsEachWayIsOne) {
  Camera camera = Distorted(-1e-3);
  camera.width = camera.height = 2;
  camera.params = {10, 1, 1, -1e-3};
  const Camera pinhole = UndistortedCamera(camera, "cameras.bin");
  EXPECT_EQ(pinhole.width, 2u);
  EXPECT_EQ(pinhole.height, 2u);
}

// r (1 - .5 r^2) has its largest value, .544, at r = .816: the corners, at .72 to .77, show nothing, and
// neither do the left and right sides, at .59 to .61.
TEST(Undistort, LensThatTurnsBackIsUsedWithin) {
  Camera camera = Distorted(-0.5);
  EXPECT_TRUE(LensTurnsBack(camera));
  EXPECT_FALSE(LensTurnsBack(Distorted(-0.15)));
  EXPECT_FALSE(LensTurnsBack(Distorted(0)));
  const Camera pinhole = UndistortedCamera(camera, "cameras.bin");
  EXPECT_EQ(FocalLengths(pinhole), FocalLengths(camera));
  const Eigen::Vector2d principal = PrincipalPoint(pinhole);
  const double turn = 100 * std::sqrt(2 / 3.0);
  double farthest = 0;
  for (const double x : {0.5, pinhole.width - 0.5}) {
    for (const double y : {0.5, pinhole.height - 0.5}) {
      farthest = std::max(farthest, (Eigen::Vector2d(x, y) - principal).norm());
    }
  }
  EXPECT_LE(farthest, turn);
  // A square within the circle, but for what the photo itself does not reach above and below, would have 2
  // r^2.
  EXPECT_GE(static_cast<double>(pinhole.width * pinhole.height), 0.9 * 2 * turn * turn);
  Reporter silent;
  const Image8 image = UndistortImage(Picture(camera), camera, pinhole, silent);
  const Image8 expected = Picture(pinhole);
  double worst = 0;
  for (int y = 0; y < image.height; ++y) {
    for (int x = 0; x < image.width; ++x) {
      // Towards the turn a pixel of the photo is many of the pinhole's.
      if ((Eigen::Vector2d(x + 0.5, y + 0.5) - principal).norm() > 0.8 * turn) continue;
      for (int c = 0; c < 3; ++c) {
        worst = std::max(worst, std::abs(1.0 * image.Pixel(x, y)[c] - expected.Pixel(x, y)[c]));
      }
    }
  }
  EXPECT_LE(worst, 6);
}

TEST(Undistort, LeavesPinholesAlone) {
  const Camera camera = Distorted(0);
  const Camera pinhole = UndistortedCamera(camera, "cameras.bin");
  EXPECT_EQ(pinhole.width, camera.width);
  EXPECT_EQ(PrincipalPoint(pinhole), PrincipalPoint(camera));
  Reporter silent;
  EXPECT_EQ(UndistortImage(Picture(camera), camera, pinhole, silent).pixels, Picture(camera).pixels);
}

// A pinhole that sees farther than the photo: its borders go on.
TEST(Undistort, BeyondThePhotoItsBorderGoesOn) {
  const Camera camera = Distorted(0);
  Camera wider = camera;
  wider.params[0] = 50;
  Image8 ramps{120, 90, 3, {}};
  for (int y = 0; y < 90; ++y) {
    for (int x = 0; x < 120; ++x) {
      for (const int value : {2 * x, 2 * y, x + y}) ramps.pixels.push_back(static_cast<uint8_t>(value));
    }
  }
  Reporter silent;
  const Image8 image = UndistortImage(ramps, camera, wider, silent);
  for (int y = 0; y < 90; ++y) {
    for (int x = 0; x < 120; ++x) {
      const double u = std::clamp((x + 0.5 - 61.3) * 2 + 61.3 - 0.5, 0.0, 119.0);
      const double v = std::clamp((y + 0.5 - 44.2) * 2 + 44.2 - 0.5, 0.0, 89.0);
      EXPECT_NEAR(image.Pixel(x, y)[0], 2 * u, 0.51) << x << " " << y;
      EXPECT_NEAR(image.Pixel(x, y)[1], 2 * v, 0.51) << x << " " << y;
      EXPECT_NEAR(image.Pixel(x, y)[2], u + v, 0.51) << x << " " << y;
    }
  }
}

TEST(Undistort, MovesKeypointsAlong) {
  ColmapModel model;
  model.cameras[3] = Distorted(-0.12);
  ColmapImage& image = model.images[1];
  image.camera_id = 3;
  const Eigen::Vector3d x_in_cam(0.3, -0.2, 1);
  image.points2D.push_back({*ProjectToImage(model.cameras[3], x_in_cam), kInvalidPoint3DId});
  const ColmapModel result = UndistortedModel(model, "sparse");
  const Eigen::Vector2d expected = *ProjectToImage(result.cameras.at(3), x_in_cam);
  EXPECT_LT((result.images.at(1).points2D[0].xy - expected).norm(), 1e-6);
}

// Asks to stop when it is asked for the n-th time.
class StopsAt : public Reporter {
 public:
  explicit StopsAt(int n) : n_(n) {}
  bool StopRequested() const override {
    EXPECT_EQ(std::this_thread::get_id(), caller_);
    return ++asked_ >= n_;
  }
  int asked() const { return asked_; }

 private:
  const std::thread::id caller_ = std::this_thread::get_id();
  int n_;
  mutable int asked_ = 0;
};

TEST(Undistort, StopsWithinOnePhoto) {
  Camera camera = Distorted(0.1);
  camera.width = 2000;
  camera.height = 1500;  // three megapixels: begun in three blocks at least
  camera.params = {1500, 1000, 750, 0.1};
  const Camera pinhole = UndistortedCamera(camera, "cameras.bin");
  const Image8 photo{2000, 1500, 1, std::vector<uint8_t>(3'000'000, 9)};
  StopsAt second(2);
  EXPECT_THROW(UndistortImage(photo, camera, pinhole, second), Interrupted);
  EXPECT_EQ(second.asked(), 2);
  StopsAt never(1000);
  UndistortImage(photo, camera, pinhole, never);
  EXPECT_GE(never.asked(), 2);
  StopsAt second_of_mask(2);
  EXPECT_THROW(DistortMask({camera, pinhole}, photo, second_of_mask), Interrupted);
  EXPECT_EQ(second_of_mask.asked(), 2);
}

TEST(UndistortBadInput, WildLens) {
  ExpectUserError([] { UndistortedCamera(Distorted(1e9), "sparse/cameras.bin"); }, {"sparse/cameras.bin"});
  Camera camera = Distorted(0);
  camera.model = CameraModelId::kFov;
  camera.params = {100, 100, 60, 45, 0.9};
  ExpectOkOrUserError([&] { UndistortedCamera(camera, "sparse/cameras.bin"); }, "sparse/cameras.bin");
}

}  // namespace
}  // namespace s2gs
