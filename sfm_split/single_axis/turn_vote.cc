#include "sfm_split/single_axis/turn_vote.h"

#include <Eigen/Dense>
#include <cmath>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/single_axis/turn_epipolar.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// The angles at which a match's rays meet.
void AddRoots(const AxisRays& rays, const RayPair& pair, const TurntableAxis& axis, const RayMatch& match,
              std::vector<double>* angles) {
  const Vector3d& n = axis.direction;
  const Vector3d& d1 = match.first.in_world;
  const Vector3d& d2 = match.second.in_world;
  const Vector3d m1 = (rays.cameras[pair.image1].centre - axis.point).cross(d1);
  const Vector3d m2 = (rays.cameras[pair.image2].centre - axis.point).cross(d2);
  const double alpha = d2.dot(n) * n.dot(m1) + m2.dot(n) * n.dot(d1);
  const double beta = d2.dot(m1) + m2.dot(d1) - alpha;
  const double gamma = n.dot(m1.cross(d2)) + n.dot(d1.cross(m2));
  const double phase = std::atan2(gamma, beta);
  if (pair.same_place) {  // the roots are 0 and 2 phase
    angles->push_back(2 * phase);
    return;
  }
  const double amplitude = std::hypot(beta, gamma);
  if (amplitude == 0) return;
  const double cosine = -alpha / amplitude;
  if (std::abs(cosine) >= 1) {
    angles->push_back(cosine > 0 ? phase : phase + kPi);
    return;
  }
  const double half = std::acos(cosine);
  angles->push_back(phase + half);
  angles->push_back(phase - half);
}

void Score(const AxisRays& rays, const RayPair& pair, const TurntableAxis& axis, double angle,
           double bound_px, TurnVote* best) {
  const RayCamera& first = rays.cameras[pair.image1];
  const RayCamera& second = rays.cameras[pair.image2];
  const Matrix3d e = EssentialOfTurn<double>(first, second, axis.direction, axis.point, angle);
  const Matrix3d turn = RotationAbout<double>(axis.direction, angle);
  const double factor = pair.focal / bound_px;
  double score = 0;
  double possible = static_cast<double>(pair.matches.size());
  for (const RayMatch& match : pair.matches) {
    const double ratio = factor * SampsonError<double>(e, match);
    const double gain = 1 - ratio * ratio;
    if (gain > 0 && MeetInFront(first, second, axis, turn, match)) {
      score += gain;
    } else {
      possible -= 1;
      if (possible <= best->score) return;
    }
  }
  if (score > best->score) *best = {angle, score};
}

}  // namespace

TurnVote BestTurn(const AxisRays& rays, const RayPair& pair, const TurntableAxis& axis, double bound_px,
                  int max_proposals) {
  std::vector<double> angles;
  for (const RayMatch& match : pair.matches) {
    if (static_cast<int>(angles.size()) >= max_proposals) break;
    AddRoots(rays, pair, axis, match, &angles);
  }
  TurnVote best;
  for (const double angle : angles) Score(rays, pair, axis, angle, bound_px, &best);
  return best;
}

}  // namespace s2gs
