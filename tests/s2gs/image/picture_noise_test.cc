#include "s2gs/image/picture_noise.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

// A picture that gets brighter to the right, with noise that its channels share.
Image8 Noisy(double sigma, double brighter, RandomNumbers& random) {
  Image8 image{120, 80, 3, {}};
  for (int y = 0; y < image.height; ++y) {
    for (int x = 0; x < image.width; ++x) {
      const double grey = 60 + 0.5 * x + brighter + sigma * random.Normal();
      image.pixels.insert(image.pixels.end(), 3, static_cast<uint8_t>(std::lround(grey)));
    }
  }
  return image;
}

// Light that drifts is no noise of a pixel, and widens what counts as the same colour.
TEST(MeasurePictureNoise, IsThatOfThePicturesWhereNothingMoves) {
  RandomNumbers random(3);
  for (const double sigma : {2.0, 5.0}) {
    const std::vector<Image8> pictures = {Noisy(sigma, 0, random), Noisy(sigma, 0, random)};
    const PictureNoise noise = MeasurePictureNoise(pictures.data(), pictures.size());
    // Of 1,371 pixels, by a median of halves of whole grey levels. Measured: .22 and .02 off.
    const double bound = 0.05 * sigma + 0.4;
    EXPECT_NEAR(noise.of_grey, sigma, bound);
    // Three deviations of a difference of two pictures.
    EXPECT_NEAR(noise.tolerance, 3 * std::sqrt(2.0) * sigma, 0.1 * 3 * sigma);
    const std::vector<Image8> drifting = {Noisy(sigma, 0, random), Noisy(sigma, 12, random)};
    const PictureNoise drift = MeasurePictureNoise(drifting.data(), drifting.size());
    EXPECT_NEAR(drift.of_grey, sigma, bound);
    EXPECT_GT(drift.tolerance, 1.5 * noise.tolerance);
  }
}

TEST(MeasurePictureNoise, IsAtLeastThatOfRounding) {
  RandomNumbers random(4);
  const std::vector<Image8> same(2, Noisy(3, 0, random));
  EXPECT_FLOAT_EQ(MeasurePictureNoise(same.data(), same.size()).of_grey, 0.5F);
  EXPECT_FLOAT_EQ(MeasurePictureNoise(same.data(), same.size()).tolerance, 1.5F);
}

}  // namespace
}  // namespace s2gs
