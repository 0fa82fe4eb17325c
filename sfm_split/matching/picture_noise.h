#pragma once

#include <opencv2/core.hpp>

namespace s2gs {

/// Of 8-bit JPEGs without any [grey levels].
constexpr double kLeastPictureNoise = 0.7;

/// Standard deviation of a picture's noise [grey levels], by Immerkaer (Fast noise variance estimation,
/// 1996), with the median in place of the mean, which texture does not disturb. At least kLeastPictureNoise.
/// \param grey  one channel, CV_8U or CV_32F.
double PictureNoise(const cv::Mat& grey);

}  // namespace s2gs
