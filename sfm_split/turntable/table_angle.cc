#include "sfm_split/turntable/table_angle.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/sampson_error.h"
#include "sfm_split/scene/axis_turn.h"
#include "sfm_split/scene/projection_jacobians.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kDistinctAngles = 5 * kDegree;  // farther apart are two answers
constexpr size_t kMaxProposals = 250;  // points or matches, evenly chosen, each of which proposes angles

// Keypoints of points of the object, in a photo of a camera whose place is known.
class PointsOnTurn {
 public:
  PointsOnTurn(const Camera& camera, const Rigid3& cam_from_world, const TurntableAxis& axis,
               const std::vector<PointInImage>& points, double max_error_px)
      : camera_(camera),
        cam_from_world_(cam_from_world),
        axis_(axis),
        points_(points),
        max_error_px_(max_error_px) {}

  // By how many agree with an angle, and how well.
  double Support(double angle, int* inliers) const {
    const Matrix3d turn = RotationAbout<double>(axis_.direction, angle);
    double score = 0;
    int count = 0;
    for (const PointInImage& point : points_) {
      Vector2d xy;
      const Vector3d x_in_world = axis_.point + turn * (point.x_in_object - axis_.point);
      if (!ProjectWithJacobians(camera_.model, camera_.params.data(), cam_from_world_ * x_in_world, &xy,
                                nullptr, nullptr)) {
        continue;
      }
      const double gain = 1 - (xy - point.xy).squaredNorm() / (max_error_px_ * max_error_px_);
      if (!(gain > 0)) continue;
      score += gain;
      ++count;
    }
    if (inliers != nullptr) *inliers = count;
    return score;
  }

  // The angle at which a point passes its ray most closely; nothing where it passes by far, or along it.
  std::optional<double> AngleOf(const PointInImage& point) const {
    const std::optional<Vector3d> ray = UnprojectFromImage(camera_, point.xy);
    if (!ray) return std::nullopt;
    const Vector3d direction = (cam_from_world_.rotation.conjugate() * *ray).normalized();
    const Vector3d from_axis = point.x_in_object - axis_.point;
    const double height = axis_.direction.dot(from_axis);
    const Vector3d e1 = from_axis - height * axis_.direction;
    const Vector3d e2 = axis_.direction.cross(e1);
    const Vector3d foot = axis_.point + height * axis_.direction - CameraCentre(cam_from_world_);
    // Across the ray: foot + cos e1 + sin e2 = 0.
    const Vector3d q1 = direction.unitOrthogonal();
    const Vector3d q2 = direction.cross(q1);
    Eigen::Matrix2d matrix;
    matrix << q1.dot(e1), q1.dot(e2), q2.dot(e1), q2.dot(e2);
    if (std::abs(matrix.determinant()) < 0.02 * e1.squaredNorm()) return std::nullopt;
    const Vector2d cos_sin = matrix.inverse() * -Vector2d(q1.dot(foot), q2.dot(foot));
    const double radius = cos_sin.norm();
    if (!(radius > 0.7 && radius < 1.4)) return std::nullopt;  // its circle passes the ray by far
    return std::atan2(cos_sin.y(), cos_sin.x());
  }

  // One step of weighted least squares; 0 where nothing agrees.
  double StepFrom(double angle) const {
    const Matrix3d turn = RotationAbout<double>(axis_.direction, angle);
    double normal = 0;
    double right = 0;
    for (const PointInImage& point : points_) {
      Vector2d xy;
      Eigen::Matrix<double, 2, 3> by_cam;
      const Vector3d from_axis = turn * (point.x_in_object - axis_.point);
      if (!ProjectWithJacobians(camera_.model, camera_.params.data(),
                                cam_from_world_ * (axis_.point + from_axis), &xy, &by_cam, nullptr)) {
        continue;
      }
      const Vector2d residual = xy - point.xy;
      const double gain = 1 - residual.squaredNorm() / (max_error_px_ * max_error_px_);
      if (!(gain > 0)) continue;
      const Vector2d by_angle = by_cam * (cam_from_world_.rotation * axis_.direction.cross(from_axis));
      normal += gain * gain * by_angle.squaredNorm();
      right -= gain * gain * by_angle.dot(residual);
    }
    return normal > 0 ? right / normal : 0;
  }

 private:
  const Camera& camera_;
  const Rigid3& cam_from_world_;
  const TurntableAxis& axis_;
  const std::vector<PointInImage>& points_;
  double max_error_px_;
};

}  // namespace

TableAngleFit FitTableAngle(const Camera& camera, const Rigid3& cam_from_world, const TurntableAxis& axis,
                            const std::vector<PointInImage>& points, double max_error_px, int min_inliers) {
  const PointsOnTurn on_turn(camera, cam_from_world, axis, points, max_error_px);
  // Evenly over the points.
  const size_t stride = std::max<size_t>(1, points.size() / kMaxProposals);
  std::vector<std::pair<double, double>> votes;  // support, angle
  for (size_t k = 0; k < points.size(); k += stride) {
    if (const std::optional<double> angle = on_turn.AngleOf(points[k]))
      votes.emplace_back(on_turn.Support(*angle, nullptr), *angle);
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
    const double step = on_turn.StepFrom(angle);
    const double score = on_turn.Support(angle + step, nullptr);
    if (score < best) break;
    best = score;
    angle += step;
    if (std::abs(step) < 1e-12) break;
  }
  best = on_turn.Support(angle, &fit.inliers);
  fit.support = best;
  fit.angle_rad = WrapAngle(angle);
  fit.margin = other > 0 ? best / other : std::numeric_limits<double>::infinity();
  fit.found = fit.inliers >= min_inliers;
  return fit;
}

namespace {

struct Rays {
  Vector3d in_cam;        // of the image, z = 1
  Vector3d other_in_cam;  // of the other one
  double focal;
};

// The matches of one pair of images.
struct PairRays {
  Rigid3 cam_from_world;
  Rigid3 other_from_object;
  std::vector<Rays> rays;
};

bool IsSame(const Rigid3& a, const Rigid3& b) {
  return a.translation == b.translation && a.rotation.coeffs() == b.rotation.coeffs();
}

std::vector<PairRays> GroupByPair(const std::vector<MatchAcrossTurn>& matches) {
  std::vector<PairRays> pairs;
  for (const MatchAcrossTurn& match : matches) {
    const std::optional<Vector3d> u = UnprojectFromImage(*match.camera, match.xy);
    const std::optional<Vector3d> v = UnprojectFromImage(*match.other_camera, match.other_xy);
    if (!u || !v) continue;
    if (pairs.empty() || !IsSame(pairs.back().cam_from_world, match.cam_from_world) ||
        !IsSame(pairs.back().other_from_object, match.other_cam_from_object)) {
      pairs.push_back({match.cam_from_world, match.other_cam_from_object, {}});
    }
    pairs.back().rays.push_back(
        {*u, *v, 0.25 * (FocalLengths(*match.camera).sum() + FocalLengths(*match.other_camera).sum())});
  }
  return pairs;
}

TurnSupport Support(const std::vector<PairRays>& pairs, const TurntableAxis& axis, double max_error_px,
                    double angle) {
  TurnSupport support;
  const Rigid3 turned = TurnAbout(axis, angle);
  for (const PairRays& pair : pairs) {
    const Rigid3 cam_from_other = pair.cam_from_world * turned * pair.other_from_object.Inverse();
    const Matrix3d rotation = cam_from_other.rotation.toRotationMatrix();
    const Vector3d& gap = cam_from_other.translation;
    for (const Rays& ray : pair.rays) {
      const Vector3d u = rotation * ray.other_in_cam;  // the other's ray, in this camera
      const Vector3d line = gap.cross(u);
      const Vector3d other_line = rotation.transpose() * ray.in_cam.cross(gap);
      const double ratio = ray.focal * SampsonError<double>(other_line, line, ray.in_cam) / max_error_px;
      const double gain = 1 - ratio * ratio;
      if (!(gain > 0)) continue;
      // In front of both: s in_cam = t u + translation with s, t > 0.
      const double uu = u.squaredNorm();
      const double vv = ray.in_cam.squaredNorm();
      const double uv = u.dot(ray.in_cam);
      if (!(uu * ray.in_cam.dot(gap) - uv * u.dot(gap) > 0) ||
          !(uv * ray.in_cam.dot(gap) - vv * u.dot(gap) > 0)) {
        continue;
      }
      support.score += gain;
      ++support.inliers;
    }
  }
  return support;
}

// The angles at which a match's rays meet.
void Propose(const PairRays& pair, const Rays& ray, const TurntableAxis& axis, std::vector<double>* angles) {
  // The object's ray d1 turned by the angle meets the image's ray d2: alpha + beta cos + gamma sin = 0 for
  // the moments about the axis' point (single_axis.h).
  const Vector3d& n = axis.direction;
  const Vector3d d1 = (pair.other_from_object.rotation.conjugate() * ray.other_in_cam).normalized();
  const Vector3d d2 = (pair.cam_from_world.rotation.conjugate() * ray.in_cam).normalized();
  const Vector3d m1 = (CameraCentre(pair.other_from_object) - axis.point).cross(d1);
  const Vector3d m2 = (CameraCentre(pair.cam_from_world) - axis.point).cross(d2);
  const double alpha = d2.dot(n) * n.dot(m1) + m2.dot(n) * n.dot(d1);
  const double beta = d2.dot(m1) + m2.dot(d1) - alpha;
  const double gamma = n.dot(m1.cross(d2)) + n.dot(d1.cross(m2));
  const double amplitude = std::hypot(beta, gamma);
  if (amplitude == 0) return;
  const double phase = std::atan2(gamma, beta);
  const double cosine = std::clamp(-alpha / amplitude, -1.0, 1.0);
  for (const double sign : {1.0, -1.0}) angles->push_back(phase + sign * std::acos(cosine));
}

}  // namespace

TurnSupport SupportOfTurn(const TurntableAxis& axis, const std::vector<MatchAcrossTurn>& matches,
                          double max_error_px, double angle_rad) {
  return Support(GroupByPair(matches), axis, max_error_px, angle_rad);
}

TableAngleFit FitTurn(const TurntableAxis& axis, const std::vector<MatchAcrossTurn>& matches,
                      double max_error_px, int min_inliers) {
  const std::vector<PairRays> pairs = GroupByPair(matches);
  const size_t stride = std::max<size_t>(1, matches.size() / kMaxProposals);
  std::vector<double> proposals;
  size_t k = 0;
  for (const PairRays& pair : pairs) {
    for (const Rays& ray : pair.rays) {
      if (k++ % stride == 0) Propose(pair, ray, axis, &proposals);
    }
  }
  std::vector<std::pair<double, double>> votes;  // support, angle
  votes.reserve(proposals.size());
  for (const double angle : proposals) {
    votes.emplace_back(Support(pairs, axis, max_error_px, angle).score, angle);
  }
  TableAngleFit fit;
  if (votes.empty()) return fit;
  std::sort(votes.rbegin(), votes.rend());
  double other = 0;
  for (const auto& [score, candidate] : votes) {
    if (std::abs(WrapAngle(candidate - votes[0].second)) > kDistinctAngles) other = std::max(other, score);
  }
  // Uphill from the best proposal, in steps that shrink.
  double angle = votes[0].second;
  double best = votes[0].first;
  for (double step = kDegree; step > 1e-5 * kDegree; step *= 0.5) {
    for (const double candidate : {angle - step, angle + step}) {
      const double score = Support(pairs, axis, max_error_px, candidate).score;
      if (score <= best) continue;
      best = score;
      angle = candidate;
    }
  }
  const TurnSupport support = Support(pairs, axis, max_error_px, angle);
  fit.inliers = support.inliers;
  fit.support = support.score;
  fit.angle_rad = WrapAngle(angle);
  fit.margin = other > 0 ? support.score / other : std::numeric_limits<double>::infinity();
  fit.found = fit.inliers >= min_inliers;
  return fit;
}

TableAngleFit FitTableAngle(const Camera& camera, const Rigid3& cam_from_world, const TurntableAxis& axis,
                            const std::vector<MatchInPosedImage>& matches, double max_error_px,
                            int min_inliers) {
  std::vector<MatchAcrossTurn> across;
  across.reserve(matches.size());
  for (const MatchInPosedImage& match : matches) {
    across.push_back(
        {&camera, cam_from_world, match.xy, match.other_camera, match.other_cam_from_object, match.other_xy});
  }
  return FitTurn(axis, across, max_error_px, min_inliers);
}

}  // namespace s2gs
