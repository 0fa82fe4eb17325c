#include "s2gs/image/photos.h"

#include <gtest/gtest.h>

#include <cmath>
#include <optional>

#include "s2gs/image/undistort.h"
#include "sfm_split/base/error.h"
#include "tests/support/bad_input.h"

namespace s2gs {
namespace {

Image8 Ramp(int width, int height, int channels) {
  Image8 image{width, height, channels, {}};
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      for (int c = 0; c < channels; ++c)
        image.pixels.push_back(static_cast<uint8_t>((3 * x + 5 * y + 40 * c) % 256));
    }
  }
  return image;
}

TEST(ResizeByArea, HalvingTakesTheMeanOfFour) {
  const Image8 image = Ramp(8, 6, 3);
  const Image8 half = ResizeByArea(image, 4, 3);
  for (int y = 0; y < 3; ++y) {
    for (int x = 0; x < 4; ++x) {
      for (int c = 0; c < 3; ++c) {
        const int sum = image.Pixel(2 * x, 2 * y)[c] + image.Pixel(2 * x + 1, 2 * y)[c] +
                        image.Pixel(2 * x, 2 * y + 1)[c] + image.Pixel(2 * x + 1, 2 * y + 1)[c];
        EXPECT_NEAR(half.Pixel(x, y)[c], sum / 4.0, 0.51);
      }
    }
  }
}

TEST(ResizeByArea, KeepsTheMeanAtAnyRatioAndConstantImages) {
  const Image8 image = Ramp(30, 20, 1);
  double mean = 0;
  for (const uint8_t value : image.pixels) mean += value / 600.0;
  const Image8 resized = ResizeByArea(image, 7, 11);
  double resized_mean = 0;
  for (const uint8_t value : resized.pixels) resized_mean += value / 77.0;
  EXPECT_NEAR(resized_mean, mean, 0.3);
  const Image8 constant{5, 5, 1, std::vector<uint8_t>(25, 200)};
  for (const uint8_t value : ResizeByArea(constant, 3, 9).pixels) EXPECT_EQ(value, 200);
}

TEST(CutAndShrink, TakesMeansOfWholeBlocksOfThePart) {
  const Image8 image = Ramp(31, 22, 3);
  const ImagePart part = {4, 3, 25, 17};
  for (const int factor : {1, 2, 3, 5}) {
    const Image8 small = CutAndShrink(image, part, factor);
    ASSERT_EQ(small.width, 25 / factor);
    ASSERT_EQ(small.height, 17 / factor);
    for (int y = 0; y < small.height; ++y) {
      for (int x = 0; x < small.width; ++x) {
        for (int c = 0; c < 3; ++c) {
          int sum = 0;
          for (int j = 0; j < factor * factor; ++j) {
            sum += image.Pixel(4 + factor * x + j % factor, 3 + factor * y + j / factor)[c];
          }
          EXPECT_NEAR(small.Pixel(x, y)[c], static_cast<double>(sum) / (factor * factor), 0.5001);
        }
      }
    }
  }
}

Camera Distorted(double k) {
  Camera camera;
  camera.camera_id = 1;
  camera.model = CameraModelId::kSimpleRadial;
  camera.width = 60;
  camera.height = 40;
  camera.params = {50, 30, 20, k};
  return camera;
}

TEST(Undistort, MovesPixelsToWhereTheirRaysPoint) {
  const Undistortion plan = PlanUndistortion(Distorted(0.15), "cameras.bin");
  // A photo whose value is the ray's x, as seen through the lens.
  Image8 photo{60, 40, 1, std::vector<uint8_t>(2400)};
  for (int y = 0; y < 40; ++y) {
    for (int x = 0; x < 60; ++x) {
      const auto ray = UnprojectFromImage(plan.source, {x + 0.5, y + 0.5});
      ASSERT_TRUE(ray.has_value());
      *photo.Pixel(x, y) = static_cast<uint8_t>(std::lround(128 + 150 * ray->x()));
    }
  }
  Reporter silent;
  const Image8 straight = UndistortImage(photo, plan.source, plan.pinhole, silent);
  const std::vector<double>& p = plan.pinhole.params;
  for (int y = 2; y + 2 < straight.height; ++y) {
    for (int x = 2; x + 2 < straight.width; ++x) {
      EXPECT_NEAR(*straight.Pixel(x, y), 128 + 150 * (x + 0.5 - p[2]) / p[0], 1.1);
    }
  }
}

TEST(Undistort, APinholeStaysAsItIs) {
  const Undistortion plan = PlanUndistortion(Distorted(0), "cameras.bin");
  EXPECT_EQ(plan.pinhole.width, 60U);
  const Image8 photo = Ramp(60, 40, 3);
  Reporter silent;
  EXPECT_EQ(UndistortImage(photo, plan.source, plan.pinhole, silent).pixels, photo.pixels);
  const Image8 mask = Ramp(60, 40, 1);
  EXPECT_EQ(DistortMask(plan, mask, silent).pixels, mask.pixels);
}

TEST(Undistort, MasksGoBackIntoThePhoto) {
  const Undistortion plan = PlanUndistortion(Distorted(0.15), "cameras.bin");
  Image8 mask{static_cast<int>(plan.pinhole.width), static_cast<int>(plan.pinhole.height), 1, {}};
  mask.pixels.assign(static_cast<size_t>(mask.width) * mask.height, 0);
  for (int y = 0; y < mask.height; ++y) {
    for (int x = 0; x < mask.width; ++x) {
      *mask.Pixel(x, y) = (x + 0.5 - plan.pinhole.params[2]) / 50 > 0.1 ? 255 : 0;
    }
  }
  Reporter silent;
  const Image8 back = DistortMask(plan, mask, silent);
  ASSERT_EQ(back.width, 60);
  for (int y = 0; y < 40; ++y) {
    for (int x = 0; x < 60; ++x) {
      const double ray = UnprojectFromImage(plan.source, {x + 0.5, y + 0.5})->x();
      if (std::abs(ray - 0.1) < 0.03) continue;
      EXPECT_EQ(*back.Pixel(x, y), ray > 0.1 ? 255 : 0) << x << " " << y;
    }
  }
}

// A mask of another size than the pinhole's: twice as wide, three times as high, with a border in rows.
TEST(Undistort, MasksOfOtherSizesGoBackToo) {
  const Undistortion plan = PlanUndistortion(Distorted(0.15), "cameras.bin");
  Image8 mask{2 * static_cast<int>(plan.pinhole.width), 3 * static_cast<int>(plan.pinhole.height), 1, {}};
  for (int y = 0; y < mask.height; ++y) {
    for (int x = 0; x < mask.width; ++x) {
      const double ray_x = ((x + 0.5) / 2 - plan.pinhole.params[2]) / plan.pinhole.params[0];
      const double ray_y = ((y + 0.5) / 3 - plan.pinhole.params[3]) / plan.pinhole.params[1];
      mask.pixels.push_back(ray_y - 0.5 * ray_x > 0.1 ? 255 : 0);
    }
  }
  Reporter silent;
  const Image8 back = DistortMask(plan, mask, silent);
  for (int y = 0; y < 40; ++y) {
    for (int x = 0; x < 60; ++x) {
      const Eigen::Vector3d ray = *UnprojectFromImage(plan.source, {x + 0.5, y + 0.5});
      const double beyond = ray.y() - 0.5 * ray.x() - 0.1;
      if (std::abs(beyond) < 0.02) continue;  // half a pixel of the mask
      EXPECT_EQ(*back.Pixel(x, y), beyond > 0 ? 255 : 0) << x << " " << y;
    }
  }
}

TEST(Undistort, CamerasThatCannotBeProjectedAreRefused) {
  Camera camera = Distorted(0);
  camera.model = CameraModelId::kFov;
  camera.params = {50, 50, 30, 20, 0.1};
  ExpectUserError([&] { PlanUndistortion(camera, "cameras.bin"); }, {"cameras.bin"});
}

TEST(ResizeView, KeepsTheRays) {
  PinholeView view;
  view.width = 640;
  view.height = 480;
  view.fx = 500;
  view.fy = 510;
  view.cx = 300;
  view.cy = 250;
  const PinholeView half = ResizeView(view, 320, 240);
  EXPECT_DOUBLE_EQ(half.fx, 250);
  EXPECT_DOUBLE_EQ(half.cy, 125);
  const PinholeView other = ResizeView(view, 64, 960);
  EXPECT_DOUBLE_EQ(other.fx, 50);
  EXPECT_DOUBLE_EQ(other.cx, 30);
  EXPECT_DOUBLE_EQ(other.fy, 1020);
  EXPECT_DOUBLE_EQ(other.cy, 500);
  EXPECT_EQ(other.width, 64);
  EXPECT_EQ(other.height, 960);
}

}  // namespace
}  // namespace s2gs
