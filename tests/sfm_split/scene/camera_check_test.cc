#include "sfm_split/scene/camera_check.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>

namespace s2gs {
namespace {

using testing::HasSubstr;
using testing::Optional;

Camera Radial(uint64_t width, uint64_t height, double focal, double cx = 300, double k = 0.1) {
  return {1, CameraModelId::kSimpleRadial, width, height, {focal, cx, 200, k}};
}

TEST(FindCameraFault, WhatPhotosMayHave) {
  for (const Camera& camera : {Radial(640, 480, 700), Radial(640, 480, 0.3 * 640), Radial(640, 480, 6400),
                               Radial(65500, 4000, 5e4), Radial(16384, 16384, 1e4), Radial(1, 1, 1)}) {
    EXPECT_EQ(FindCameraFault(camera), std::nullopt);
  }
}

TEST(FindCameraFault, WhatNoneHas) {
  const double inf = std::numeric_limits<double>::infinity();
  EXPECT_THAT(FindCameraFault(Radial(2'000'000'000, 480, 700)), Optional(HasSubstr("2000000000 x 480")));
  EXPECT_THAT(FindCameraFault(Radial(640, uint64_t{1} << 63U, 700)), Optional(HasSubstr("a side")));
  EXPECT_THAT(FindCameraFault(Radial(65501, 4000, 5e4)), Optional(HasSubstr("65501 x 4000")));
  EXPECT_THAT(FindCameraFault(Radial(4000, 65501, 5e4)), Optional(HasSubstr("4000 x 65501")));
  EXPECT_THAT(FindCameraFault(Radial(0, 480, 700)), Optional(HasSubstr("0 x 480")));
  EXPECT_THAT(FindCameraFault(Radial(60000, 60000, 700)), Optional(HasSubstr("in all")));
  for (const double focal : {1e300, 1e-300, 6.5e6, 0.06}) {
    EXPECT_THAT(FindCameraFault(Radial(640, 480, focal)), Optional(HasSubstr("no lens"))) << focal;
  }
  for (const double focal : {0.0, -1.0})
    EXPECT_THAT(FindCameraFault(Radial(640, 480, focal)), Optional(HasSubstr("positive")));
  EXPECT_THAT(FindCameraFault(Radial(640, 480, 700, -1e300)), Optional(HasSubstr("principal point")));
  for (const double value : {inf, -inf, std::numeric_limits<double>::quiet_NaN()}) {
    EXPECT_THAT(FindCameraFault(Radial(640, 480, 700, 300, value)), Optional(HasSubstr("not finite")));
  }
  Camera camera = Radial(640, 480, 700);
  camera.params.pop_back();
  EXPECT_THAT(FindCameraFault(camera), Optional(HasSubstr("takes 4")));
}

}  // namespace
}  // namespace s2gs
