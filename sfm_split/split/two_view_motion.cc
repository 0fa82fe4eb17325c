#include "sfm_split/split/two_view_motion.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#include <string>

#include "sfm_split/base/number_text.h"
#include "sfm_split/base/sampson_error.h"

namespace s2gs {
namespace {

// A homography that explains this share of the epipolar inliers explains them better: the points are
// coplanar.
constexpr double kPlanarShare = 0.9;

Eigen::Matrix3d ToEigen(const cv::Mat& matrix) {
  Eigen::Matrix3d result;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) result(r, c) = matrix.at<double>(r, c);
  }
  return result;
}

double TransferError(const Eigen::Matrix3d& H, const Eigen::Vector2f& xy1, const Eigen::Vector2f& xy2) {
  const Eigen::Vector3d mapped = H * xy1.cast<double>().homogeneous();
  return (mapped.hnormalized() - xy2.cast<double>()).norm();
}

// A robust fit of OpenCV's; empty when it refuses the matches: they lie on one spot or on one line.
template <class Fit>
cv::Mat FitOrNothing(const Fit& fit) {
  try {
    return fit();
  } catch (const cv::Exception&) {
    return {};
  }
}

}  // namespace

OptionCheck TwoViewMotionOptions::Check() const {
  if (!(max_error_px > 0)) return OptionFault{"max_error_px", NumberText(max_error_px), "> 0"};
  if (!(confidence > 0 && confidence < 1)) {
    return OptionFault{"confidence", NumberText(confidence), "0 < confidence < 1"};
  }
  if (max_iterations < 1) return OptionFault{"max_iterations", std::to_string(max_iterations), ">= 1"};
  if (min_inliers < 8) return OptionFault{"min_inliers", std::to_string(min_inliers), ">= 8"};
  if (max_motions < 1) return OptionFault{"max_motions", std::to_string(max_motions), ">= 1"};
  return std::nullopt;
}

double SampsonErrorPx(const Eigen::Matrix3d& F, const Eigen::Vector2f& xy1, const Eigen::Vector2f& xy2) {
  return std::abs(
      SampsonError<double>(F, xy1.cast<double>().homogeneous(), xy2.cast<double>().homogeneous()));
}

TwoViewMotion FitMotion(const Keypoints& keypoints1, const Keypoints& keypoints2,
                        const FeatureMatches& matches, const std::vector<int>& subset,
                        const TwoViewMotionOptions& options) {
  TwoViewMotion motion;
  if (static_cast<int>(subset.size()) < options.min_inliers) return motion;
  std::vector<cv::Point2f> points1;
  std::vector<cv::Point2f> points2;
  points1.reserve(subset.size());
  points2.reserve(subset.size());
  for (const int m : subset) {
    const Eigen::Vector2f& xy1 = keypoints1[matches[m].point2D_idx1];
    const Eigen::Vector2f& xy2 = keypoints2[matches[m].point2D_idx2];
    points1.emplace_back(xy1.x(), xy1.y());
    points2.emplace_back(xy2.x(), xy2.y());
  }

  cv::Mat mask;
  const cv::Mat F = FitOrNothing([&] {
    return cv::findFundamentalMat(points1, points2, cv::USAC_MAGSAC, options.max_error_px, options.confidence,
                                  options.max_iterations, mask);
  });
  if (F.rows != 3 || F.cols != 3) return motion;
  motion.F = ToEigen(F);
  for (const int m : subset) {
    if (SampsonErrorPx(motion.F, keypoints1[matches[m].point2D_idx1], keypoints2[matches[m].point2D_idx2]) <=
        options.max_error_px) {
      motion.inliers.push_back(m);
    }
  }
  if (static_cast<int>(motion.inliers.size()) < options.min_inliers) {
    motion.inliers.clear();
    return motion;
  }

  std::vector<cv::Point2f> inliers1;
  std::vector<cv::Point2f> inliers2;
  for (const int m : motion.inliers) {
    inliers1.emplace_back(keypoints1[matches[m].point2D_idx1].x(), keypoints1[matches[m].point2D_idx1].y());
    inliers2.emplace_back(keypoints2[matches[m].point2D_idx2].x(), keypoints2[matches[m].point2D_idx2].y());
  }
  const cv::Mat H = FitOrNothing([&] {
    return cv::findHomography(inliers1, inliers2, cv::USAC_MAGSAC, options.max_error_px, mask,
                              options.max_iterations, options.confidence);
  });
  if (H.rows == 3 && H.cols == 3) {
    const Eigen::Matrix3d homography = ToEigen(H);
    const auto num_planar = std::count_if(motion.inliers.begin(), motion.inliers.end(), [&](int m) {
      return TransferError(homography, keypoints1[matches[m].point2D_idx1],
                           keypoints2[matches[m].point2D_idx2]) <= 2 * options.max_error_px;
    });
    if (static_cast<double>(num_planar) >= kPlanarShare * static_cast<double>(motion.inliers.size())) {
      motion.is_planar = true;
      motion.H = homography;
    }
  }
  return motion;
}

std::vector<TwoViewMotion> FitMotions(const Keypoints& keypoints1, const Keypoints& keypoints2,
                                      const FeatureMatches& matches, const std::vector<int>& subset,
                                      const TwoViewMotionOptions& options) {
  std::vector<TwoViewMotion> motions;
  std::vector<int> left = subset;
  while (static_cast<int>(motions.size()) < options.max_motions) {
    TwoViewMotion motion = FitMotion(keypoints1, keypoints2, matches, left, options);
    if (motion.inliers.empty()) break;
    std::vector<int> rest;
    std::set_difference(left.begin(), left.end(), motion.inliers.begin(), motion.inliers.end(),
                        std::back_inserter(rest));
    left = std::move(rest);
    motions.push_back(std::move(motion));
  }
  return motions;
}

}  // namespace s2gs
