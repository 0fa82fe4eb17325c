#include "sfm_split/table_angle.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "sfm_split/reprojection_cost.h"
#include "sfm_split/rotation.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kDegree = 3.14159265358979323846 / 180;
constexpr double kDistinctAngles = 5 * kDegree;
constexpr size_t kMaxProposals = 250;

}  // namespace

TableAngleFit FitTableAngle(const Camera& camera, const Rigid3& cam_from_world, const TurntableAxis& axis,
                            const std::vector<PointInImage>& points, double max_error_px, int min_inliers) {
  const Vector3d centre = CameraCentre(cam_from_world);
  const auto turned = [&](const Matrix3d& turn, const Vector3d& x) -> Vector3d {
    return axis.point + turn * (x - axis.point);
  };
  const auto support = [&](double angle, int* inliers) {
    const Matrix3d turn = RotationAbout<double>(axis.direction, angle);
    double score = 0;
    int count = 0;
    for (const PointInImage& point : points) {
      Vector2d xy;
      if (!ProjectWithJacobians(camera.model, camera.params.data(),
                                cam_from_world * turned(turn, point.x_in_object), &xy, nullptr, nullptr)) {
        continue;
      }
      const double gain = 1 - (xy - point.xy).squaredNorm() / (max_error_px * max_error_px);
      if (!(gain > 0)) continue;
      score += gain;
      ++count;
    }
    if (inliers != nullptr) *inliers = count;
    return score;
  };

  // Evenly over the points.
  const size_t stride = std::max<size_t>(1, points.size() / kMaxProposals);
  std::vector<std::pair<double, double>> votes;  // support, angle
  for (size_t k = 0; k < points.size(); k += stride) {
    const std::optional<Vector3d> ray = UnprojectFromImage(camera, points[k].xy);
    if (!ray) continue;
    const Vector3d direction = (cam_from_world.rotation.conjugate() * *ray).normalized();
    const Vector3d from_axis = points[k].x_in_object - axis.point;
    const double height = axis.direction.dot(from_axis);
    const Vector3d e1 = from_axis - height * axis.direction;
    const Vector3d e2 = axis.direction.cross(e1);
    const Vector3d foot = axis.point + height * axis.direction - centre;
    // Across the ray: foot + cos e1 + sin e2 = 0.
    const Vector3d q1 = direction.unitOrthogonal();
    const Vector3d q2 = direction.cross(q1);
    Eigen::Matrix2d matrix;
    matrix << q1.dot(e1), q1.dot(e2), q2.dot(e1), q2.dot(e2);
    if (std::abs(matrix.determinant()) < 0.02 * e1.squaredNorm()) continue;
    const Vector2d cos_sin = matrix.inverse() * -Vector2d(q1.dot(foot), q2.dot(foot));
    const double radius = cos_sin.norm();
    if (!(radius > 0.7 && radius < 1.4)) continue;  // its circle passes the ray by far
    const double angle = std::atan2(cos_sin.y(), cos_sin.x());
    votes.emplace_back(support(angle, nullptr), angle);
  }
  TableAngleFit fit;
  if (votes.empty()) return fit;
  std::sort(votes.rbegin(), votes.rend());
  double angle = votes[0].second;
  double best = votes[0].first;
  double other = 0;
  for (const auto& [score, candidate] : votes) {
    if (std::abs(WrapAngle(candidate - angle)) > kDistinctAngles) other = std::max(other, score);
  }
  for (int iteration = 0; iteration < 10; ++iteration) {
    const Matrix3d turn = RotationAbout<double>(axis.direction, angle);
    double normal = 0;
    double right = 0;
    for (const PointInImage& point : points) {
      Vector2d xy;
      Eigen::Matrix<double, 2, 3> by_cam;
      const Vector3d from_axis = turn * (point.x_in_object - axis.point);
      if (!ProjectWithJacobians(camera.model, camera.params.data(), cam_from_world * (axis.point + from_axis),
                                &xy, &by_cam, nullptr)) {
        continue;
      }
      const Vector2d residual = xy - point.xy;
      const double gain = 1 - residual.squaredNorm() / (max_error_px * max_error_px);
      if (!(gain > 0)) continue;
      const Vector2d by_angle = by_cam * (cam_from_world.rotation * axis.direction.cross(from_axis));
      normal += gain * gain * by_angle.squaredNorm();
      right -= gain * gain * by_angle.dot(residual);
    }
    if (!(normal > 0)) break;
    const double score = support(angle + right / normal, nullptr);
    if (score < best) break;
    best = score;
    angle += right / normal;
    if (std::abs(right / normal) < 1e-12) break;
  }
  best = support(angle, &fit.inliers);
  fit.angle_rad = WrapAngle(angle);
  fit.margin = other > 0 ? best / other : std::numeric_limits<double>::infinity();
  fit.found = fit.inliers >= min_inliers;
  return fit;
}

}  // namespace s2gs
