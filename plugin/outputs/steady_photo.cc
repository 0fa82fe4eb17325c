#include "plugin/outputs/steady_photo.h"

#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <utility>

namespace s2gs {
namespace {

// The camera's turn moves neighbouring pixels alike: over so many px it bends by less than .001 px.
constexpr int kCellPx = 8;

}  // namespace

GreyPhoto SteadyPhoto(GreyPhoto photo, const std::string& name, const SteadyCameras& cameras) {
  if (photo.grey.empty() || !cameras.HasMoved(name)) return photo;
  const int rows = photo.height / kCellPx + 2;
  const int cols = photo.width / kCellPx + 2;
  cv::Mat places(rows, cols, CV_32FC2);  // where each corner of the cells is photographed
  for (int y = 0; y < rows; ++y) {
    for (int x = 0; x < cols; ++x) {
      const Eigen::Vector2d corner(x * kCellPx, y * kCellPx);
      const Eigen::Vector2d at = cameras.PhotographedPixel(name, corner).value_or(corner);
      places.at<cv::Vec2f>(y, x) = {static_cast<float>(at.x()), static_cast<float>(at.y())};
    }
  }
  cv::Mat map(photo.height, photo.width, CV_32FC2);
  for (int y = 0; y < photo.height; ++y) {
    const float v = (static_cast<float>(y) + 0.5F) / kCellPx;
    const int row = static_cast<int>(v);
    for (int x = 0; x < photo.width; ++x) {
      const float u = (static_cast<float>(x) + 0.5F) / kCellPx;
      const int col = static_cast<int>(u);
      const float a = u - static_cast<float>(col);
      const float b = v - static_cast<float>(row);
      const cv::Vec2f at =
          (1 - b) * ((1 - a) * places.at<cv::Vec2f>(row, col) + a * places.at<cv::Vec2f>(row, col + 1)) +
          b * ((1 - a) * places.at<cv::Vec2f>(row + 1, col) + a * places.at<cv::Vec2f>(row + 1, col + 1));
      map.at<cv::Vec2f>(y, x) = at - cv::Vec2f(0.5F, 0.5F);  // OpenCV counts from the first pixel's centre
    }
  }
  GreyPhoto steady{photo.width, photo.height, std::vector<uint8_t>(photo.grey.size())};
  const cv::Mat from(photo.height, photo.width, CV_8U, photo.grey.data());
  cv::Mat to(steady.height, steady.width, CV_8U, steady.grey.data());
  cv::remap(from, to, map, cv::noArray(), cv::INTER_LANCZOS4, cv::BORDER_REPLICATE);
  return steady;
}

}  // namespace s2gs
