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

// An angle about the axis, by its cosine and sine.
template <typename T>
struct Turned {
  T cosine, sine;
  Vector<T> operator()(const Vector<T>& v) const {
    return Vector<T>(cosine * v.x() - sine * v.y(), sine * v.x() + cosine * v.y(), v.z());
  }
};

// \param sign  of the unknown against the angle, which is the `place`th.
template <typename T>
Turned<T> TurnedBy(double cosine, double sine, double sign, int place) {
  Turned<T> turned{T(cosine), T(sine)};
  if constexpr (std::is_same_v<T, Jet>) {
    turned.cosine.v(place) = -sine * sign;
    turned.sine.v(place) = cosine * sign;
  }
  return turned;
}

// The point, at the middle photo and in the camera's frame, as a pixel about the principal point.
template <typename T>
std::optional<Eigen::Matrix<T, 2, 1>> Project(const Vector<T>& in_frame, const CircularLens& lens,
                                              double focal_px, const CircularTurn& turn) {
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
  T focal(focal_px);
  if constexpr (std::is_same_v<T, Jet>) focal.v(kLogFocal) = focal_px;
  return Eigen::Matrix<T, 2, 1>(focal * (T(1) + k * u.squaredNorm()) * u);
}

template <typename T>
std::optional<T> ErrorOf(const CircularTriple& triple, const LensPoint& first, const LensPoint& last,
                         const CircularLens& lens, double focal, const CircularTurn& turn,
                         const Turned<T>& to_first, const Turned<T>& to_last) {
  // From the axis, as the table stands in the middle photo.
  const Vector<T> centre(T(-1), T(0), T(0));
  const std::optional<Vector<T>> x = MeetingOfRays<T>(to_first(centre), to_first(RayInFrame<T>(first, turn)),
                                                      to_last(centre), to_last(RayInFrame<T>(last, turn)));
  if (!x) return std::nullopt;
  const auto seen = Project<T>(*x - centre, lens, focal, turn);
  if (!seen) return std::nullopt;
  const Vector2d along = (triple.xy[2] - triple.xy[0]).normalized();
  return T(along.x()) * ((*seen)(0) - T(triple.xy[1].x())) +
         T(along.y()) * ((*seen)(1) - T(triple.xy[1].y()));
}

}  // namespace

TripleErrors::TripleErrors(const CircularLens& lens, const CircularTurn& turn,
                           const std::array<int, 3>& photos)
    : lens_(lens), turn_(turn), focal_(std::exp(lens.log_focal)) {
  const auto angle = [&](size_t k) { return turn.angles[static_cast<size_t>(photos[k])]; };
  const double to_first = angle(1) - angle(0);
  const double to_last = -(angle(2) - angle(1));
  cosines_ << std::cos(to_first), std::cos(to_last);
  sines_ << std::sin(to_first), std::sin(to_last);
}

double TripleErrors::Of(const CircularTriple& triple, TripleDerivative* derivative) const {
  if (derivative != nullptr) derivative->setZero();
  const LensPoint first = ThroughLens(lens_, focal_, triple.xy[0]);
  const LensPoint last = ThroughLens(lens_, focal_, triple.xy[2]);
  if (!first.is_valid || !last.is_valid || triple.xy[0] == triple.xy[2]) return kInfinity;
  const auto error_of = [&](auto zero) {
    using T = decltype(zero);
    return ErrorOf<T>(triple, first, last, lens_, focal_, turn_,
                      TurnedBy<T>(cosines_(0), sines_(0), 1, kFirstAngle),
                      TurnedBy<T>(cosines_(1), sines_(1), -1, kSecondAngle));
  };
  if (derivative == nullptr) return error_of(0.0).value_or(kInfinity);
  const std::optional<Jet> error = error_of(Jet(0));
  if (!error) return kInfinity;
  *derivative = error->v;
  return error->a;
}

double TripleError(const CircularTriple& triple, const CircularLens& lens, const CircularTurn& turn,
                   const std::array<int, 3>& photos, TripleDerivative* derivative) {
  return TripleErrors(lens, turn, photos).Of(triple, derivative);
}

}  // namespace s2gs
