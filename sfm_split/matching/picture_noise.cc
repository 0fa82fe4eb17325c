#include "sfm_split/matching/picture_noise.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <utility>
#include <vector>

#include "sfm_split/base/statistics.h"

namespace s2gs {

double PictureNoise(const cv::Mat& grey) {
  const cv::Mat kernel = (cv::Mat_<float>(3, 3) << 1, -2, 1, -2, 4, -2, 1, -2, 1);
  cv::Mat rough;
  cv::filter2D(grey, rough, CV_32F, kernel);
  std::vector<float> sizes;
  sizes.reserve(rough.total());
  for (int y = 0; y < rough.rows; ++y) {
    for (int x = 0; x < rough.cols; ++x) sizes.push_back(std::abs(rough.at<float>(y, x)));
  }
  // The kernel's norm is 6.
  return std::max(kLeastPictureNoise, kSigmaOfMad * UpperMedian(std::move(sizes)) / 6);
}

}  // namespace s2gs
