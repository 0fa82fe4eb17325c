#include "sfm_split/scene/focal_prior.h"

#include <gtest/gtest.h>

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
  const double sigma = FocalPriorOf(given, false).sigma_log;
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

}  // namespace
}  // namespace s2gs
