#include "sfm_split/scene/focal_prior.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

namespace s2gs {
namespace {

Camera Radial(double focal_px, double k) {
  Camera camera;
  camera.model = CameraModelId::kSimpleRadial;
  camera.width = 1000;
  camera.height = 800;
  camera.params = {focal_px, 500, 400, k};
  return camera;
}

// Half the square of each deviation, in closed form.
TEST(FocalPrior, LensesAreAsLikelyAsTheyAreNearToWhatIsKnown) {
  const Camera given = Radial(1500, -0.1);
  const double sigma = FocalPriorOf(given, false).likeliest.sigma_log;
  EXPECT_NEAR(LogPriorOfLens(Radial(1200, -0.1), given, false), 0, 1e-12);
  EXPECT_NEAR(LogPriorOfLens(Radial(1200 * std::exp(2 * sigma), -0.1), given, false), -2, 1e-12);
  EXPECT_NEAR(LogPriorOfLens(Radial(1200, -0.1 + 3 * kDistortionSigma), given, false), -4.5, 1e-12);
  // EXIF says where it is, and to 5 %.
  EXPECT_NEAR(LogPriorOfLens(Radial(1500 * std::exp(-0.05), -0.1), given, true), -0.5, 1e-12);
  // A lens of a model without distortion has none to be compared.
  Camera pinhole = Radial(1200, 0);
  pinhole.model = CameraModelId::kSimplePinhole;
  pinhole.params.pop_back();
  EXPECT_NEAR(LogPriorOfLens(pinhole, given, false), 0, 1e-12);
}

// One time in ten EXIF is wrong, and says nothing then: the larger of two weighted normals, in closed form.
TEST(FocalPrior, FarFromWhatIsStatedLensesAreAsLikelyAsIfNothingWere) {
  const Camera given = Radial(500, 0);
  const FocalPrior stated = FocalPriorOf(given, true);
  const FocalPrior unstated = FocalPriorOf(given, false);
  const double of_wrong = std::log(0.1 / 0.9 * 0.05 / unstated.likeliest.sigma_log);
  for (const double focal_px : {400.0, 480.0, 500.0, 530.0, 560.0, 600.0, 700.0, 1250.0}) {
    const double x = std::log(focal_px);
    const double off = (x - std::log(500)) / 0.05;
    const double right = -0.5 * off * off;
    const double wrong = of_wrong + unstated.LogDensity(x);
    EXPECT_NEAR(stated.LogDensity(x), std::max(right, wrong), 1e-12) << focal_px;
    EXPECT_EQ(stated.IsAsStated(x), right > wrong) << focal_px;
    EXPECT_EQ(stated.At(x).focal_px, right > wrong ? 500 : unstated.likeliest.focal_px) << focal_px;
    EXPECT_FALSE(unstated.IsAsStated(x));
  }
  EXPECT_TRUE(stated.IsAsStated(std::log(560)));
  EXPECT_FALSE(stated.IsAsStated(std::log(600)));
}

}  // namespace
}  // namespace s2gs
