#include "sfm_split/rim/edge_picture.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

constexpr double kSmoothPx = 0.7;  // what a lens does anyway: noise and blocks of compression fall
constexpr double kClear =
    0.7;  // of the picture's slopes are less: among clutter many are steeper than a rim's
// Of Sobel's sum, four times a step of two grey values over two pixels: before a plain wall less is noise and
// compression, and all else would be an edge.
constexpr float kLeastSobel = 8;

}  // namespace

EdgePicture::EdgePicture(const GreyPicture& picture)
    : width_(picture.width), height_(picture.height), scale_(picture.Scale()) {
  const cv::Mat bytes(height_, width_, CV_8UC1, const_cast<uint8_t*>(picture.grey.data()));
  cv::Mat grey;
  bytes.convertTo(grey, CV_32F);
  cv::GaussianBlur(grey, grey, {0, 0}, kSmoothPx);
  brightness_.assign(grey.begin<float>(), grey.end<float>());
}

float EdgePicture::BrightnessAt(const Eigen::Vector2d& xy) const {
  const double x = xy.x() - 0.5;
  const double y = xy.y() - 0.5;
  const auto column = static_cast<int>(x);
  const auto row = static_cast<int>(y);
  const auto u = static_cast<float>(x - column);
  const auto v = static_cast<float>(y - row);
  const float* at = brightness_.data() + static_cast<size_t>(row) * width_ + column;
  const float above = at[0] + u * (at[1] - at[0]);
  const float below = at[width_] + u * (at[width_ + 1] - at[width_]);
  return above + v * (below - above);
}

std::vector<EdgePicture::Edge> EdgePicture::Edges() const {
  const cv::Mat grey(height_, width_, CV_32F, const_cast<float*>(brightness_.data()));
  cv::Mat gx;
  cv::Mat gy;
  cv::Sobel(grey, gx, CV_32F, 1, 0);
  cv::Sobel(grey, gy, CV_32F, 0, 1);
  cv::Mat slope;
  cv::magnitude(gx, gy, slope);
  const float least =
      std::max(kLeastSobel, Quantile(std::vector<float>(slope.begin<float>(), slope.end<float>()), kClear));
  std::vector<Edge> edges;
  for (int y = 1; y + 1 < height_; ++y) {
    for (int x = 1; x + 1 < width_; ++x) {
      const float here = slope.at<float>(y, x);
      if (!(here > least)) continue;
      const Eigen::Vector2d normal(gx.at<float>(y, x) / here, gy.at<float>(y, x) / here);
      const auto dx = static_cast<int>(std::lround(normal.x()));
      const auto dy = static_cast<int>(std::lround(normal.y()));
      if (here < slope.at<float>(y + dy, x + dx) || here < slope.at<float>(y - dy, x - dx)) continue;
      edges.push_back({Eigen::Vector2d(x + 0.5, y + 0.5), normal});
    }
  }
  return edges;
}

EdgeDirections::EdgeDirections(double focal_px, const Eigen::Vector2i& reach)
    : focal_px_(focal_px), reach_(reach), width_(2 * static_cast<size_t>(reach.x())) {
  masks_.assign(width_ * 2 * static_cast<size_t>(reach.y()), 0);
}

int EdgeDirections::DirectionOf(const Eigen::Vector2d& normal) {
  // Asked a hundred million times a picture: by the side of the sectors' borders, which are half as dear as
  // an angle. The same for both senses.
  static const std::array<Eigen::Vector2d, kDirections - 1> kBorders = [] {
    std::array<Eigen::Vector2d, kDirections - 1> borders;
    for (int k = 1; k < kDirections; ++k)
      borders[static_cast<size_t>(k) - 1] = {std::cos(k * kPi / kDirections),
                                             std::sin(k * kPi / kDirections)};
    return borders;
  }();
  const bool is_turned = normal.y() < 0 || (normal.y() == 0 && normal.x() < 0);
  const double x = is_turned ? -normal.x() : normal.x();
  const double y = is_turned ? -normal.y() : normal.y();
  int direction = 0;
  for (const Eigen::Vector2d& border : kBorders) direction += border.x() * y >= border.y() * x ? 1 : 0;
  return direction;
}

void EdgeDirections::Add(const Eigen::Vector2d& xy, const Eigen::Vector2d& normal) {
  if (!Contains(xy)) return;
  // Its own direction and the one next to it: directions are told to within some fifteen degrees.
  constexpr double kAside = 0.2;
  const Eigen::Vector2d beside(-normal.y(), normal.x());
  for (const double aside : {-kAside, kAside})
    masks_[CellOf(xy)] |= static_cast<uint8_t>(1U << DirectionOf(normal + aside * beside));
}

void EdgeDirections::Spread() {
  const std::vector<uint8_t> own = masks_;
  const auto width = static_cast<int>(width_);
  const auto height = static_cast<int>(own.size() / width_);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      for (int v = std::max(0, y - 1); v <= std::min(height - 1, y + 1); ++v) {
        for (int u = std::max(0, x - 1); u <= std::min(width - 1, x + 1); ++u)
          masks_[static_cast<size_t>(y) * width_ + x] |= own[static_cast<size_t>(v) * width_ + u];
      }
    }
  }
}

double EdgeDirections::Share() const {
  size_t count = 0;
  for (const uint8_t mask : masks_) {
    for (int k = 0; k < kDirections; ++k) count += mask >> k & 1U;
  }
  return static_cast<double>(count) / static_cast<double>(kDirections * std::max<size_t>(1, masks_.size()));
}

}  // namespace s2gs
