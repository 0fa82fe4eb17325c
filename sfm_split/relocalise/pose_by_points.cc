#include "sfm_split/relocalise/pose_by_points.h"

#include <cmath>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>

#include "sfm_split/base/error.h"
#include "sfm_split/base/rotation.h"

namespace s2gs {
namespace {

constexpr int kSamples = 5000;          // at most
constexpr double kConfidence = 0.9999;  // that one of the samples is without a wrong point

// Root mean square of the distances from the mean.
template <class Vector>
double Spread(const std::vector<Vector>& points, Vector* mean) {
  mean->setZero();
  for (const Vector& x : points) *mean += x / static_cast<double>(points.size());
  double squares = 0;
  for (const Vector& x : points) squares += (x - *mean).squaredNorm();
  return std::sqrt(squares / static_cast<double>(points.size()));
}

}  // namespace

std::optional<PoseByPoints> FitPoseByPoints(const std::vector<Eigen::Vector3d>& in_object,
                                            const std::vector<Eigen::Vector2d>& in_plane, double focal,
                                            double max_error_px, int least) {
  S2GS_INVARIANT(in_object.size() == in_plane.size());
  if (in_object.empty() || static_cast<int>(in_object.size()) < least) return std::nullopt;
  // SQPnP takes points for one spot by an absolute bound, and SfM's unit is arbitrary.
  Eigen::Vector3d middle;
  const double spread = Spread(in_object, &middle);
  if (!(spread > 0) || !std::isfinite(spread)) return std::nullopt;
  std::vector<cv::Point3d> points;
  std::vector<cv::Point2d> seen;
  for (size_t k = 0; k < in_object.size(); ++k) {
    const Eigen::Vector3d x = (in_object[k] - middle) / spread;
    points.emplace_back(x.x(), x.y(), x.z());
    seen.emplace_back(in_plane[k].x(), in_plane[k].y());
  }
  const cv::Matx33d calibration(focal, 0, 0, 0, focal, 0, 0, 0, 1);
  cv::Vec3d turn;
  cv::Vec3d translation;
  std::vector<int> inliers;
  try {
    if (!cv::solvePnPRansac(points, seen, calibration, cv::noArray(), turn, translation, false, kSamples,
                            static_cast<float>(max_error_px), kConfidence, inliers, cv::SOLVEPNP_SQPNP)) {
      return std::nullopt;
    }
  } catch (const cv::Exception&) {
    return std::nullopt;  // what agrees lies on one spot or on one line
  }
  if (static_cast<int>(inliers.size()) < least) return std::nullopt;
  std::vector<Eigen::Vector2d> agreeing;
  agreeing.reserve(inliers.size());
  for (const int k : inliers) agreeing.push_back(in_plane[static_cast<size_t>(k)]);
  Eigen::Vector2d centre;
  if (Spread(agreeing, &centre) <= max_error_px) return std::nullopt;  // any turn would fit

  PoseByPoints pose;
  pose.cam_from_object.rotation =
      Eigen::Quaterniond(ExpRotation<double>(Eigen::Vector3d(turn[0], turn[1], turn[2])));
  pose.cam_from_object.translation =
      spread * Eigen::Vector3d(translation[0], translation[1], translation[2]) -
      pose.cam_from_object.rotation * middle;
  if (!pose.cam_from_object.translation.allFinite() || !pose.cam_from_object.rotation.coeffs().allFinite()) {
    return std::nullopt;
  }
  pose.inliers = static_cast<int>(inliers.size());
  pose.candidates = static_cast<int>(in_object.size());
  return pose;
}

}  // namespace s2gs
