#include "sfm_split/circular_motion/circular_errors.h"

#include <Eigen/Dense>
#include <array>
#include <cmath>
#include <limits>

#include "sfm_split/base/rotation.h"
#include "sfm_split/circular_motion/circular_lens.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

Matrix3d EssentialInFrame(double angle) {
  const double c = std::cos(angle);
  const double s = std::sin(angle);
  Matrix3d r;
  r << c, -s, 0, s, c, 0, 0, 0, 1;
  return CrossMatrix<double>(Vector3d(1 - c, -s, 0)) * r;
}

Matrix3d EssentialByAngle(double angle) {
  const double c = std::cos(angle);
  const double s = std::sin(angle);
  Matrix3d r;
  Matrix3d dr;
  r << c, -s, 0, s, c, 0, 0, 0, 1;
  dr << -s, -c, 0, c, -s, 0, 0, 0, 0;
  return CrossMatrix<double>(Vector3d(s, -c, 0)) * r + CrossMatrix<double>(Vector3d(1 - c, -s, 0)) * dr;
}

}  // namespace

void ErrorsOf(const CircularMatches::Pair& pair, double reach_px, const CircularLens& lens,
              const CircularTurn& turn, bool with_derivatives, PairErrors* result) {
  const double angle =
      turn.angles[static_cast<size_t>(pair.photo2)] - turn.angles[static_cast<size_t>(pair.photo1)];
  const Matrix3d e = turn.frame * EssentialInFrame(angle) * turn.frame.transpose();
  Matrix3d by_angle;
  std::array<Matrix3d, 3> by_turn;
  if (with_derivatives) {
    by_angle = turn.frame * EssentialByAngle(angle) * turn.frame.transpose();
    for (int k = 0; k < 3; ++k) {
      const Matrix3d cross = CrossMatrix<double>(Vector3d(Vector3d::Unit(k)));
      by_turn[static_cast<size_t>(k)] = cross * e - e * cross;
    }
  }
  const size_t num = pair.matches.size();
  result->errors.assign(num, std::numeric_limits<double>::infinity());
  if (with_derivatives) result->derivatives.assign(num, PairDerivative::Zero());
  const double farthest_px =
      reach_px > 0 ? reach_px * 2 * std::abs(std::sin(angle / 2)) : std::numeric_limits<double>::infinity();
  const double focal = std::exp(lens.log_focal);
  for (size_t m = 0; m < num; ++m) {
    if ((pair.matches[m].second - pair.matches[m].first).norm() > farthest_px) continue;
    const LensPoint first = ThroughLens(lens, focal, pair.matches[m].first);
    const LensPoint second = ThroughLens(lens, focal, pair.matches[m].second);
    if (!first.is_valid || !second.is_valid) continue;
    const Vector3d line2 = e * first.ray;
    const Vector3d line1 = e.transpose() * second.ray;
    const double squared = line2.head<2>().squaredNorm() / (second.px * second.px) +
                           line1.head<2>().squaredNorm() / (first.px * first.px);
    if (!(squared > 1e-30)) continue;
    const double scale = 1 / std::sqrt(squared);
    result->errors[m] = scale * second.ray.dot(line2);
    if (!with_derivatives) continue;
    // Of the numerator, and of half the denominator's square: both grow with the angle alike.
    PairDerivative& d = result->derivatives[m];
    PairDerivative half = PairDerivative::Zero();
    const double of1 = 1 / (first.px * first.px);
    const double of2 = 1 / (second.px * second.px);
    const auto along = [&](int k, const Vector3d& d_line2, const Vector3d& d_line1) {
      half(k) = of2 * line2.head<2>().dot(d_line2.head<2>()) + of1 * line1.head<2>().dot(d_line1.head<2>());
    };
    d(0) = second.by_log_focal.dot(line2) + first.by_log_focal.dot(line1);
    along(0, e * first.by_log_focal, e.transpose() * second.by_log_focal);
    half(0) -= squared;  // pixels per unit grow with the focal length
    d(1) = second.by_distortion.dot(line2) + first.by_distortion.dot(line1);
    along(1, e * first.by_distortion, e.transpose() * second.by_distortion);
    for (int k = 0; k < 4; ++k) {
      const Matrix3d& change = k < 3 ? by_turn[static_cast<size_t>(k)] : by_angle;
      const Vector3d d_line2 = change * first.ray;
      d(2 + k) = second.ray.dot(d_line2);
      along(2 + k, d_line2, change.transpose() * second.ray);
    }
    d -= (result->errors[m] * scale) * half;
    d *= scale;
  }
}

void ErrorsOf(const CircularMatches::Row& row, const CircularLens& lens, const CircularTurn& turn,
              bool with_derivatives, RowErrors* result) {
  const size_t num = row.triples.size();
  result->errors.resize(num);
  if (with_derivatives) result->derivatives.resize(num);
  const TripleErrors errors(lens, turn, row.photos);
  for (size_t m = 0; m < num; ++m)
    result->errors[m] = errors.Of(row.triples[m], with_derivatives ? &result->derivatives[m] : nullptr);
}

}  // namespace s2gs
