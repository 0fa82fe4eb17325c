#include "sfm_split/scene/pose_error.h"

#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <complex>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr double kDegreesPerRadian = 180 / kPi;  // errors are told in degrees

// Below this ratio of the second to the first principal extent, errors of a ten-thousandth of the extent,
// which is what good SfM leaves, would decide about the rotation around the line.
constexpr double kCollinearRatio = 1e-4;

// Rounding alone leaves equal centres about this far apart, relative to their distance from the origin.
constexpr double kCoincidentRatio = 1e-12;

struct CentredPoints {
  Vector3d mean;
  Eigen::Matrix3Xd offsets;
  Vector3d extents;  // root mean squares along the principal axes, in decreasing order.
};

CentredPoints Centre(const std::vector<Vector3d>& points) {
  CentredPoints centred;
  const auto count = static_cast<Eigen::Index>(points.size());
  centred.offsets.resize(3, count);
  for (Eigen::Index i = 0; i < count; ++i) centred.offsets.col(i) = points[static_cast<size_t>(i)];
  centred.mean = centred.offsets.rowwise().mean();
  centred.offsets.colwise() -= centred.mean;
  const Matrix3d covariance = centred.offsets * centred.offsets.transpose() / static_cast<double>(count);
  centred.extents = Eigen::JacobiSVD<Matrix3d>(covariance).singularValues().cwiseSqrt();
  return centred;
}

bool AllFinite(const std::vector<Vector3d>& points) {
  return std::all_of(points.begin(), points.end(), [](const Vector3d& x) { return x.allFinite(); });
}

// 2 sin(angle) * axis of a rotation.
Vector3d SineVector(const Matrix3d& r) { return {r(2, 1) - r(1, 2), r(0, 2) - r(2, 0), r(1, 0) - r(0, 1)}; }

// Rotations since the first image.
std::vector<Matrix3d> SinceFirst(const std::vector<Quaterniond>& rotations) {
  std::vector<Matrix3d> relative;
  relative.reserve(rotations.size());
  for (const Quaterniond& q : rotations) {
    relative.push_back((q * rotations.front().conjugate()).normalized().toRotationMatrix());
  }
  return relative;
}

std::vector<double> AnglesAbout(const Vector3d& axis, const std::vector<Matrix3d>& rotations) {
  std::vector<double> angles;
  angles.reserve(rotations.size());
  for (const Matrix3d& r : rotations) {
    angles.push_back(std::atan2(SineVector(r).dot(axis) / 2, (r.trace() - 1) / 2));
  }
  return angles;
}

Vector3d CommonAxis(const std::vector<Matrix3d>& rotations) {
  Matrix3d scatter = Matrix3d::Zero();
  for (const Matrix3d& r : rotations) scatter += SineVector(r) * SineVector(r).transpose();
  return Eigen::JacobiSVD<Matrix3d>(scatter, Eigen::ComputeFullV).matrixV().col(0);
}

double AngleBetweenDeg(const Vector3d& a, const Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b)) * kDegreesPerRadian;
}

}  // namespace

std::string_view Describe(FitStatus status) {
  switch (status) {
    case FitStatus::kOk:
      return "the cameras determine a similarity";
    case FitStatus::kCollinear:
      return "the cameras stand at two places or on one line, which leaves the rotation about it open";
    case FitStatus::kCoincident:
      return "all cameras stand at one place";
    case FitStatus::kNotFinite:
      return "a camera's pose is not finite";
  }
  return "";
}

Sim3Fit FitSim3(const std::vector<Vector3d>& x_in_a, const std::vector<Vector3d>& x_in_b,
                double min_extent_in_b) {
  S2GS_INVARIANT(x_in_a.size() == x_in_b.size());
  Sim3Fit fit;
  if (!AllFinite(x_in_a) || !AllFinite(x_in_b)) {
    fit.status = FitStatus::kNotFinite;
    return fit;
  }
  if (x_in_a.size() < 2) return fit;
  const CentredPoints a = Centre(x_in_a);
  const CentredPoints b = Centre(x_in_b);
  const double min_a = kCoincidentRatio * a.mean.norm();
  const double min_b = std::max(min_extent_in_b, kCoincidentRatio * b.mean.norm());
  if (!(a.extents[0] > min_a) || !(b.extents[0] > min_b)) return fit;

  const auto count = static_cast<double>(x_in_a.size());
  const Matrix3d covariance = b.offsets * a.offsets.transpose() / count;
  const Eigen::JacobiSVD<Matrix3d> svd(covariance, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Vector3d signs = Vector3d::Ones();
  if (svd.matrixU().determinant() * svd.matrixV().determinant() < 0) signs[2] = -1;
  fit.b_from_a.scale = svd.singularValues().dot(signs) / (a.offsets.squaredNorm() / count);

  const bool is_line =
      !(a.extents[1] > kCollinearRatio * a.extents[0]) || !(b.extents[1] > kCollinearRatio * b.extents[0]);
  if (is_line || !(b.extents[1] > min_b)) {
    fit.status = FitStatus::kCollinear;
    return fit;
  }
  const Matrix3d rotation = svd.matrixU() * signs.asDiagonal() * svd.matrixV().transpose();
  fit.b_from_a.rotation = Quaterniond(rotation).normalized();
  fit.b_from_a.translation = b.mean - fit.b_from_a.scale * (fit.b_from_a.rotation * a.mean);
  fit.status = FitStatus::kOk;
  return fit;
}

PoseErrors ComparePoses(const PoseMap& estimate, const PoseMap& truth, double min_extent) {
  PoseErrors errors;
  std::vector<Vector3d> estimated_centres;
  std::vector<Vector3d> true_centres;
  for (const auto& [name, cam_from_frame] : estimate) {
    const auto match = truth.find(name);
    if (match == truth.end()) continue;
    errors.names.push_back(name);
    estimated_centres.push_back(CameraCentre(cam_from_frame));
    true_centres.push_back(CameraCentre(match->second));
  }
  errors.truth_from_estimate = FitSim3(estimated_centres, true_centres, min_extent);
  if (errors.truth_from_estimate.status != FitStatus::kOk) return errors;
  const Sim3& truth_from_estimate = errors.truth_from_estimate.b_from_a;
  for (size_t i = 0; i < errors.names.size(); ++i) {
    const Quaterniond& estimated = estimate.at(errors.names[i]).rotation;
    const Quaterniond& truly = truth.at(errors.names[i]).rotation;
    errors.rotation_deg.push_back(
        RotationAngleDeg(estimated * truth_from_estimate.rotation.conjugate() * truly.conjugate()));
    errors.centre_length.push_back((truth_from_estimate * estimated_centres[i] - true_centres[i]).norm());
  }
  return errors;
}

double RotationAngleDeg(const Quaterniond& rotation) {
  return 2 * std::atan2(rotation.vec().norm(), std::abs(rotation.w())) * kDegreesPerRadian;
}

std::vector<double> TurntableAngleErrorsDeg(const std::vector<Quaterniond>& estimated_world_from_object,
                                            const std::vector<Quaterniond>& true_world_from_object,
                                            const Vector3d& true_axis) {
  const size_t count = true_world_from_object.size();
  S2GS_INVARIANT(estimated_world_from_object.size() == count);
  S2GS_INVARIANT(true_axis.norm() > 0);
  if (count < 2) return {};
  const std::vector<double> true_angles =
      AnglesAbout(true_axis.normalized(), SinceFirst(true_world_from_object));
  const std::vector<Matrix3d> estimated = SinceFirst(estimated_world_from_object);
  const std::vector<double> estimated_angles = AnglesAbout(CommonAxis(estimated), estimated);

  std::vector<double> best;
  for (const int sense : {1, -1}) {
    std::vector<std::complex<double>> turns(count);
    std::complex<double> sum = 0;
    for (size_t i = 0; i < count; ++i) {
      turns[i] = std::polar(1.0, sense * estimated_angles[i] - true_angles[i]);
      sum += turns[i];
    }
    // Differences spread evenly over the circle have no mean; any offset is as good as none then.
    const bool has_mean = std::abs(sum) > 1e-12 * static_cast<double>(count);
    const std::complex<double> offset = has_mean ? sum / std::abs(sum) : 1;
    std::vector<double> errors(count);
    for (size_t i = 0; i < count; ++i) {
      errors[i] = std::abs(std::arg(turns[i] / offset)) * kDegreesPerRadian;
    }
    if (best.empty() || Summarize(errors).median < Summarize(best).median) best = std::move(errors);
  }
  return best;
}

AxisError CompareAxes(const TurntableAxis& estimate, const TurntableAxis& truth,
                      const Sim3& truth_from_estimate) {
  const Vector3d direction = (truth_from_estimate.rotation * estimate.direction).normalized();
  const Vector3d point = truth_from_estimate * estimate.point;
  AxisError error;
  const double angle = AngleBetweenDeg(direction, truth.direction);
  error.direction_deg = std::min(angle, 180 - angle);
  error.offset = direction.cross(truth.point - point).norm();
  return error;
}

std::vector<double> RelativePoseErrorsDeg(const PoseMap& estimate, const PoseMap& truth,
                                          double min_baseline) {
  std::vector<double> errors;
  errors.reserve(truth.size() * (truth.size() - std::min<size_t>(truth.size(), 1)) / 2);
  for (auto first = truth.begin(); first != truth.end(); ++first) {
    const auto estimated_first = estimate.find(first->first);
    for (auto second = std::next(first); second != truth.end(); ++second) {
      const auto estimated_second = estimate.find(second->first);
      if (estimated_first == estimate.end() || estimated_second == estimate.end()) {
        errors.push_back(180);
        continue;
      }
      const Rigid3 true_relative = first->second * second->second.Inverse();
      const Rigid3 estimated_relative = estimated_first->second * estimated_second->second.Inverse();
      double error = RotationAngleDeg(estimated_relative.rotation * true_relative.rotation.conjugate());
      if (true_relative.translation.norm() > min_baseline) {
        error = std::max(error, AngleBetweenDeg(estimated_relative.translation, true_relative.translation));
      }
      errors.push_back(error);
    }
  }
  return errors;
}

double AreaUnderRecall(std::vector<double> errors, double threshold) {
  S2GS_INVARIANT(threshold > 0);
  if (errors.empty()) return 0;
  std::sort(errors.begin(), errors.end());
  const auto count = static_cast<double>(errors.size());
  double area = 0;
  double last_error = 0;
  double last_recall = 0;
  for (size_t i = 0; i < errors.size() && errors[i] < threshold; ++i) {
    const double recall = static_cast<double>(i + 1) / count;
    area += (errors[i] - last_error) * (last_recall + recall) / 2;
    last_error = errors[i];
    last_recall = recall;
  }
  area += (threshold - last_error) * last_recall;
  return area / threshold;
}

}  // namespace s2gs
