#include "sfm_split/matching/picture_noise.h"

#include <gtest/gtest.h>

#include <cmath>
#include <opencv2/core.hpp>
#include <random>

namespace s2gs {
namespace {

// A slope, a parabola across it, edges of squares on a tenth of the picture, and white noise.
cv::Mat NoisyPicture(double sigma) {
  std::mt19937 random(5);
  std::normal_distribution<double> gauss;
  cv::Mat picture(300, 400, CV_32F);
  for (int y = 0; y < picture.rows; ++y) {
    for (int x = 0; x < picture.cols; ++x) {
      const double edge = x % 40 < 6 && y % 40 < 24 ? 90 : 0;
      picture.at<float>(y, x) =
          static_cast<float>(20 + 0.2 * x + 0.001 * y * y + edge + sigma * gauss(random));
    }
  }
  return picture;
}

TEST(PictureNoise, IsThatOfTheNoiseDespiteSlopesAndEdges) {
  for (const double sigma : {1.0, 3.0, 12.0}) {
    EXPECT_NEAR(PictureNoise(NoisyPicture(sigma)) / sigma, 1, 0.03) << sigma;  // measured: 0.017
  }
}

TEST(PictureNoise, IsTheSameOfBytesAndOfFloats) {
  cv::Mat bytes;
  NoisyPicture(3).convertTo(bytes, CV_8U);
  cv::Mat floats;
  bytes.convertTo(floats, CV_32F);
  EXPECT_EQ(PictureNoise(bytes), PictureNoise(floats));
}

TEST(PictureNoise, IsNeverLessThanThatOfABareJpeg) {
  EXPECT_EQ(PictureNoise(NoisyPicture(0)), kLeastPictureNoise);
}

}  // namespace
}  // namespace s2gs
