#include "sfm_split/scene/camera_projection.h"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <unsupported/Eigen/AutoDiff>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

constexpr int kMaxDegree = 6;  // in the squared radius: a cubic numerator times a cubic denominator
using Coefficients = std::array<double, kMaxDegree + 1>;

double Evaluate(const Coefficients& polynomial, double s) {
  double value = 0;
  for (int i = kMaxDegree; i >= 0; --i) value = value * s + polynomial[i];
  return value;
}

Coefficients Product(const Coefficients& a, const Coefficients& b) {
  Coefficients product{};
  for (int i = 0; i <= kMaxDegree; ++i) {
    for (int j = 0; i + j <= kMaxDegree; ++j) product[i + j] += a[i] * b[j];
  }
  return product;
}

// A polynomial in Bernstein form lies between its smallest and largest coefficient: positive coefficients
// prove it positive, a coefficient at an end that is not positive disproves it, else both halves are looked
// at.
bool BernsteinIsPositive(const Coefficients& bernstein, int depth) {
  if (!(bernstein.front() > 0) || !(bernstein.back() > 0)) return false;
  if (*std::min_element(bernstein.begin(), bernstein.end()) > 0) return true;
  if (depth == 0) return false;
  Coefficients left{};
  Coefficients right = bernstein;
  for (int i = 0; i <= kMaxDegree; ++i) {  // de Casteljau at 1/2.
    left[i] = right[0];
    for (int j = 0; j < kMaxDegree - i; ++j) right[j] = (right[j] + right[j + 1]) / 2;
  }
  return BernsteinIsPositive(left, depth - 1) && BernsteinIsPositive(right, depth - 1);
}

// What all but the constant term sum up to at most, for s in [0, end].
double LargestRest(const Coefficients& polynomial, double end) {
  double sum = 0;
  for (int i = kMaxDegree; i > 0; --i) sum = (sum + std::abs(polynomial[i])) * end;
  return sum;
}

// Whether sum_i polynomial[i] * s^i is positive for every s in [0, end].
bool IsPositiveUpTo(const Coefficients& polynomial, double end) {
  // So far from 0 that no rounding matters, as nearly every lens is within its photo.
  if (LargestRest(polynomial, end) < 0.5 * polynomial[0]) return true;
  // Row n: n over j.
  constexpr double kBinomial[kMaxDegree + 1][kMaxDegree + 1] = {
      {1, 0, 0, 0, 0, 0, 0}, {1, 1, 0, 0, 0, 0, 0},   {1, 2, 1, 0, 0, 0, 0},    {1, 3, 3, 1, 0, 0, 0},
      {1, 4, 6, 4, 1, 0, 0}, {1, 5, 10, 10, 5, 1, 0}, {1, 6, 15, 20, 15, 6, 1},
  };
  Coefficients bernstein{};
  double power = 1;
  for (int i = 0; i <= kMaxDegree; ++i, power *= end) {
    const double scaled = polynomial[i] * power / kBinomial[kMaxDegree][i];
    if (polynomial[i] == 0) continue;
    if (!std::isfinite(scaled)) return false;
    for (int j = i; j <= kMaxDegree; ++j) bernstein[j] += scaled * kBinomial[j][i];
  }
  return BernsteinIsPositive(bernstein, 40);
}

// The radial part of a lens: a distance r from the axis becomes r * numerator(r^2) / denominator(r^2).
class RadialLens {
 public:
  explicit RadialLens(const Camera& camera) {
    const double* k = camera.params.data() + InfoOf(camera.model).FirstExtraParam();
    switch (camera.model) {
      case CameraModelId::kSimpleRadial:
        numerator_ = {1, k[0]};
        break;
      case CameraModelId::kRadial:
      case CameraModelId::kOpenCV:
        numerator_ = {1, k[0], k[1]};
        break;
      case CameraModelId::kOpenCVFisheye:
        numerator_ = {1, k[0], k[1], k[2], k[3]};
        break;
      case CameraModelId::kFullOpenCV:
        numerator_ = {1, k[0], k[1], k[4]};
        denominator_ = {1, k[5], k[6], k[7]};
        break;
      default:
        break;
    }
    // d/dr of r N / D, times D^2: (N + 2 s N') D - 2 s N D', a polynomial in s = r^2.
    Coefficients twice_s_n{};
    Coefficients twice_s_d{};
    for (int i = 0; i <= kMaxDegree; ++i) {
      twice_s_n[i] = 2 * i * numerator_[i];
      twice_s_d[i] = 2 * i * denominator_[i];
    }
    Coefficients slope_n = numerator_;
    for (int i = 0; i <= kMaxDegree; ++i) slope_n[i] += twice_s_n[i];
    if (camera.model != CameraModelId::kFullOpenCV) {
      slope_ = slope_n;  // D is 1
      return;
    }
    const Coefficients a = Product(slope_n, denominator_);
    const Coefficients b = Product(numerator_, twice_s_d);
    for (int i = 0; i <= kMaxDegree; ++i) slope_[i] = a[i] - b[i];
  }

  double Distort(double r) const { return r * Evaluate(numerator_, r * r) / Evaluate(denominator_, r * r); }

  // Whether distances up to r grow with r: beyond the turning point different rays share a pixel.
  bool IsMonotonicUpTo(double r) const {
    return IsPositiveUpTo(denominator_, r * r) && IsPositiveUpTo(slope_, r * r);
  }

  // The r with Distort(r) == distorted before the turning point, or the turning point when there is none.
  double Undistort(double distorted) const {
    const auto is_before = [&](double r) { return IsMonotonicUpTo(r) && Distort(r) < distorted; };
    double low = 0;
    double high = distorted;
    while (is_before(high) && high < 1e12) {
      low = high;
      high *= 2;
    }
    for (int i = 0; i < 200 && low < high; ++i) {
      const double middle = low + (high - low) / 2;
      if (middle == low || middle == high) break;
      (is_before(middle) ? low : high) = middle;
    }
    return low;
  }

 private:
  Coefficients numerator_ = {1};
  Coefficients denominator_ = {1};
  Coefficients slope_{};
};

struct DistortedPoint {
  Eigen::Vector2d value;
  Eigen::Matrix2d jacobian;
};

DistortedPoint DistortWithJacobian(const Camera& camera, const Eigen::Vector2d& uv) {
  using Dual = Eigen::AutoDiffScalar<Eigen::Vector2d>;
  const size_t first_extra = InfoOf(camera.model).FirstExtraParam();
  std::array<Dual, 8> extra;
  for (size_t i = first_extra; i < camera.params.size(); ++i) {
    extra[i - first_extra] = Dual(camera.params[i], Eigen::Vector2d::Zero());
  }
  Dual distorted_u;
  Dual distorted_v;
  DistortNormalized<Dual>(camera.model, extra.data(), Dual(uv.x(), 2, 0), Dual(uv.y(), 2, 1), &distorted_u,
                          &distorted_v);
  DistortedPoint point;
  point.value = {distorted_u.value(), distorted_v.value()};
  point.jacobian.row(0) = distorted_u.derivatives().transpose();
  point.jacobian.row(1) = distorted_v.derivatives().transpose();
  return point;
}

// Relative to the largest of 1 and the point's distance from the axis, in focal lengths.
constexpr double kMaxResidual = 1e-12;

// Solves DistortNormalized(uv) == distorted by Newton's method with step halving, from a start value.
// The result lies on the branch that holds the axis, or there is none.
std::optional<Eigen::Vector2d> UndistortFrom(const Camera& camera, const RadialLens& lens,
                                             const Eigen::Vector2d& distorted, Eigen::Vector2d uv) {
  const double scale = std::max(1.0, distorted.norm());
  DistortedPoint point = DistortWithJacobian(camera, uv);
  double residual = (point.value - distorted).norm();
  for (int iteration = 0; iteration < 50 && residual > 0; ++iteration) {
    const Eigen::Vector2d full_step = point.jacobian.inverse() * (point.value - distorted);
    if (!full_step.allFinite()) break;
    bool improved = false;
    for (double damping = 1; damping > 1e-3 && !improved; damping /= 2) {
      const Eigen::Vector2d next = uv - damping * full_step;
      const DistortedPoint next_point = DistortWithJacobian(camera, next);
      const double next_residual = (next_point.value - distorted).norm();
      if (!(next_residual < residual)) continue;
      uv = next;
      point = next_point;
      residual = next_residual;
      improved = true;
    }
    if (!improved) break;
  }
  if (!(residual <= kMaxResidual * scale)) return std::nullopt;
  if (!(point.jacobian.determinant() > 0) || !lens.IsMonotonicUpTo(uv.norm())) return std::nullopt;
  return uv;
}

void CheckCamera(const Camera& camera) {
  const CameraModelInfo& info = InfoOf(camera.model);
  if (!info.has_projection) RequireProjection(camera, "cameras");  // throws; a path takes its time to make
  S2GS_INVARIANT(camera.params.size() == info.NumParams());
}

bool HasLens(const Camera& camera) { return InfoOf(camera.model).num_extra_params > 0; }

}  // namespace

std::optional<Eigen::Vector2d> ProjectToImage(const Camera& camera, const Eigen::Vector3d& x_in_cam) {
  CheckCamera(camera);
  Eigen::Vector2d xy;
  if (!ProjectPoint(camera.model, camera.params.data(), x_in_cam.data(), xy.data())) return std::nullopt;
  if (!xy.allFinite()) return std::nullopt;
  if (!HasLens(camera)) return xy;

  Eigen::Vector2d uv = x_in_cam.head<2>() / x_in_cam.z();
  if (camera.model == CameraModelId::kOpenCVFisheye) {
    const double r = x_in_cam.head<2>().norm();
    if (r > 0) uv = x_in_cam.head<2>() * (std::atan2(r, x_in_cam.z()) / r);
  }
  if (!RadialLens(camera).IsMonotonicUpTo(uv.norm())) return std::nullopt;
  if (!(DistortWithJacobian(camera, uv).jacobian.determinant() > 0)) return std::nullopt;
  return xy;
}

std::optional<Eigen::Vector3d> UnprojectFromImage(const Camera& camera, const Eigen::Vector2d& xy) {
  CheckCamera(camera);
  const Eigen::Vector2d distorted = (xy - PrincipalPoint(camera)).cwiseQuotient(FocalLengths(camera));
  if (!distorted.allFinite()) return std::nullopt;
  if (!HasLens(camera)) return Eigen::Vector3d(distorted.x(), distorted.y(), 1);

  const RadialLens lens(camera);
  std::optional<Eigen::Vector2d> uv = UndistortFrom(camera, lens, distorted, distorted);
  if (!uv) {
    const double r = distorted.norm();
    if (!(r > 0)) return std::nullopt;
    uv = UndistortFrom(camera, lens, distorted, distorted * (lens.Undistort(r) / r));
    if (!uv) return std::nullopt;
  }
  if (camera.model == CameraModelId::kOpenCVFisheye) {
    const double theta = uv->norm();
    if (!(theta < kPi / 2)) return std::nullopt;
    if (theta > 0) *uv *= std::tan(theta) / theta;
  }
  return Eigen::Vector3d(uv->x(), uv->y(), 1);
}

}  // namespace s2gs
