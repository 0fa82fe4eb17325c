#include "sfm_split/circular_motion/circular_triples.h"

#include <ceres/jet.h>

#include <Eigen/Dense>
#include <cmath>
#include <optional>
#include <type_traits>

#include "sfm_split/base/infinity.h"
#include "sfm_split/circular_motion/circular_lens.h"
#include "sfm_split/scene/ray_meeting.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using Jet = ceres::Jet<double, 7>;
template <typename T>
using Vector = Eigen::Matrix<T, 3, 1>;

// Where the unknowns stand in a TripleDerivative.
constexpr int kLogFocal = 0;     // CircularLens's
constexpr int kDistortion = 1;   // CircularLens's
constexpr int kTurn = 2;         // of the axis's frame, three
constexpr int kFirstAngle = 5;   // how far the table turned from the first photo to the middle one
constexpr int kSecondAngle = 6;  // and from there to the last

template <typename T>
T Unknown(double value, int place) {
  if constexpr (std::is_same_v<T, Jet>) return Jet(value, place);
  return T(value);
}

// In the frame of the axis: along the foot, across, up.
template <typename T>
Vector<T> RayInFrame(const LensPoint& point, const CircularTurn& turn) {
  const Vector3d ray = turn.frame.transpose() * point.ray;
  Vector<T> result;
  if constexpr (std::is_same_v<T, Jet>) {
    const Vector3d by_log_focal = turn.frame.transpose() * point.by_log_focal;
    const Vector3d by_distortion = turn.frame.transpose() * point.by_distortion;
    for (int k = 0; k < 3; ++k) {
      result(k) = Jet(ray(k));
      result(k).v(kLogFocal) = by_log_focal(k);
      result(k).v(kDistortion) = by_distortion(k);
      // A frame that turns by w turns the ray by -w in it.
      result(k).v.template segment<3>(kTurn) = turn.frame.col(k).cross(point.ray);
    }
  } else {
    result = ray;
  }
  return result;
}

template <typename T>
Vector<T> AboutAxis(const T& angle, const Vector<T>& v) {
  using std::cos;
  using std::sin;
  const T c = cos(angle);
  const T s = sin(angle);
  return Vector<T>(c * v.x() - s * v.y(), s * v.x() + c * v.y(), v.z());
}

// The point, at the middle photo and in the camera's frame, as a pixel about the principal point.
template <typename T>
std::optional<Eigen::Matrix<T, 2, 1>> Project(const Vector<T>& in_frame, const CircularLens& lens,
                                              const CircularTurn& turn) {
  using std::exp;
  const Vector<T> unturned = turn.frame.template cast<T>() * in_frame;
  Vector<T> x = unturned;
  if constexpr (std::is_same_v<T, Jet>) {
    Vector<T> w;
    for (int k = 0; k < 3; ++k) w(k) = Jet(0, kTurn + k);
    x += w.cross(unturned);
  }
  if (!(x.z() > T(0))) return std::nullopt;
  const Eigen::Matrix<T, 2, 1> u = x.template head<2>() / x.z();
  const T k = Unknown<T>(lens.distortion, kDistortion);
  const T focal = exp(Unknown<T>(lens.log_focal, kLogFocal));
  return Eigen::Matrix<T, 2, 1>(focal * (T(1) + k * u.squaredNorm()) * u);
}

template <typename T>
std::optional<T> ErrorOf(const CircularTriple& triple, const LensPoint& first, const LensPoint& last,
                         const CircularLens& lens, const CircularTurn& turn,
                         const std::array<int, 3>& photos) {
  const auto angle = [&](size_t k) { return turn.angles[static_cast<size_t>(photos[k])]; };
  // From the axis, as the table stands in the middle photo.
  const Vector<T> centre(T(-1), T(0), T(0));
  const T to_first = Unknown<T>(angle(1) - angle(0), kFirstAngle);
  const T to_last = -Unknown<T>(angle(2) - angle(1), kSecondAngle);
  const std::optional<Vector<T>> x =
      MeetingOfRays<T>(AboutAxis<T>(to_first, centre), AboutAxis<T>(to_first, RayInFrame<T>(first, turn)),
                       AboutAxis<T>(to_last, centre), AboutAxis<T>(to_last, RayInFrame<T>(last, turn)));
  if (!x) return std::nullopt;
  const auto seen = Project<T>(*x - centre, lens, turn);
  if (!seen) return std::nullopt;
  const Vector2d along = (triple.xy[2] - triple.xy[0]).normalized();
  return T(along.x()) * ((*seen)(0) - T(triple.xy[1].x())) +
         T(along.y()) * ((*seen)(1) - T(triple.xy[1].y()));
}

}  // namespace

double TripleError(const CircularTriple& triple, const CircularLens& lens, const CircularTurn& turn,
                   const std::array<int, 3>& photos, TripleDerivative* derivative) {
  if (derivative != nullptr) derivative->setZero();
  const double focal = std::exp(lens.log_focal);
  const LensPoint first = ThroughLens(lens, focal, triple.xy[0]);
  const LensPoint last = ThroughLens(lens, focal, triple.xy[2]);
  if (!first.is_valid || !last.is_valid || triple.xy[0] == triple.xy[2]) return kInfinity;
  if (derivative == nullptr)
    return ErrorOf<double>(triple, first, last, lens, turn, photos).value_or(kInfinity);
  const std::optional<Jet> error = ErrorOf<Jet>(triple, first, last, lens, turn, photos);
  if (!error) return kInfinity;
  *derivative = error->v;
  return error->a;
}

}  // namespace s2gs
