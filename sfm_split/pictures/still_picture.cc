#include "sfm_split/pictures/still_picture.h"

#include <Eigen/Dense>
#include <cstdint>
#include <numeric>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "sfm_split/base/median_of_pictures.h"

namespace s2gs {

GreyPicture MedianPicture(const std::vector<const GreyPicture*>& pictures) {
  GreyPicture median = *pictures.front();
  const auto sum = [](const GreyPicture& picture) {
    return std::accumulate(picture.grey.begin(), picture.grey.end(), 1.0);
  };
  std::vector<double> gains;
  std::vector<const std::vector<uint8_t>*> greys;
  for (const GreyPicture* picture : pictures) {
    gains.push_back(sum(median) / sum(*picture));
    greys.push_back(&picture->grey);
  }
  median.grey = MedianOfPictures(greys, static_cast<size_t>(median.width), gains);
  return median;
}

GreyPicture SeenFrom(const Eigen::Matrix3d& second_from_first, const GreyPicture& second) {
  if (second_from_first.isIdentity()) return second;
  // OpenCV counts from the middle of the first pixel.
  Eigen::Matrix3d to_corner = Eigen::Matrix3d::Identity();
  to_corner.topRightCorner<2, 1>().setConstant(0.5);
  const Eigen::Matrix3d H = to_corner.inverse() * second_from_first * to_corner;
  cv::Matx33d map;
  for (int i = 0; i < 9; ++i) map(i / 3, i % 3) = H(i / 3, i % 3);
  GreyPicture seen = second;
  const cv::Mat from(second.height, second.width, CV_8UC1, const_cast<uint8_t*>(second.grey.data()));
  cv::Mat to(second.height, second.width, CV_8UC1, seen.grey.data());
  cv::warpPerspective(from, to, map, to.size(), cv::INTER_CUBIC | cv::WARP_INVERSE_MAP, cv::BORDER_REPLICATE);
  return seen;
}

}  // namespace s2gs
