#include "sfm_split/rim/rim_alignment.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <optional>
#include <string>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/infinity.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/joint_system/rim_circle.h"

namespace s2gs {
namespace {

using Eigen::Vector3d;

constexpr int kUnknowns = 8;               // of a pose (w, C), and a circle's height and radius
constexpr int kRounds = 30;                // at most
constexpr double kTurnRad = 10 * kDegree;  // how far poses may be wrong: what the rim does not tell stays
constexpr double kShift = 0.3;             // the same, of the camera's distance from the axis' point
constexpr double kSettled = 1e-6;          // relative change of the cost
// Of the diagonal: less is Gauss and Newton's step, more moves by less than is settled.
constexpr double kLeastDamping = 1e-9;
constexpr double kMostDamping = 1e6;

struct State {
  Rigid3 cam_from_world;
  RimCircle circle;
};

// The nearest pose to one from which places lie on the picture of a circle about an axis.
class NearestPose {
 public:
  NearestPose(const Camera& camera, const Rigid3& cam_from_world, const Eigen::Vector4d& axis,
              const RimPrior& rim)
      : camera_(camera), given_(cam_from_world), axis_(axis), rim_(rim) {
    shift_ = kShift * (CameraCentre(given_) - Vector3d(axis(2), axis(3), 0)).norm();
  }

  std::optional<Rigid3> Find() const {
    const std::optional<RimCircle> circle = NearestRimCircle(camera_, given_, axis_, rim_.places);
    if (!circle) return std::nullopt;
    State state{given_, *circle};
    Normal normal;
    double cost = Sum(state, &normal);
    double damping = 1e-3;
    for (int round = 0; round < kRounds && damping < kMostDamping; ++round) {
      Eigen::Matrix<double, kUnknowns, kUnknowns> damped = normal.matrix;
      damped.diagonal() *= 1 + damping;
      const Step step = -damped.ldlt().solve(normal.gradient);
      const State next = Moved(state, step);
      Normal there;
      const double cost_there = Sum(next, &there);
      if (!(cost_there < cost)) {
        damping *= 8;
        continue;
      }
      const bool has_settled = cost - cost_there <= kSettled * cost;
      state = next;
      normal = there;
      cost = cost_there;
      damping = std::max(kLeastDamping, damping / 8);
      if (has_settled) break;
    }
    return state.cam_from_world;
  }

 private:
  using Step = Eigen::Matrix<double, kUnknowns, 1>;
  struct Normal {
    Eigen::Matrix<double, kUnknowns, kUnknowns> matrix;
    Step gradient;
  };

  static State Moved(const State& from, const Step& step) {
    State to = from;
    const Vector3d centre = CameraCentre(from.cam_from_world) + step.segment<3>(3);
    to.cam_from_world.rotation =
        (Eigen::Quaterniond(ExpRotation<double>(Vector3d(step.head<3>()))) * from.cam_from_world.rotation)
            .normalized();
    to.cam_from_world.translation = -(to.cam_from_world.rotation * centre);
    to.circle.height += step(6);
    to.circle.radius += step(7);
    return to;
  }

  double Sum(const State& state, Normal* normal) const {
    normal->matrix.setZero();
    normal->gradient.setZero();
    double cost = 0;
    for (const Eigen::Vector2d& place : rim_.places) {
      const std::optional<RimOffset> offset =
          OffsetFromRim(camera_, state.cam_from_world, axis_, state.circle, place);
      if (!offset) return kInfinity;
      Step row;
      row << offset->by_pose.transpose(), offset->by_circle.transpose();
      row /= rim_.sigma_px;
      const double residual = offset->px / rim_.sigma_px;
      normal->matrix += row * row.transpose();
      normal->gradient += residual * row;
      cost += residual * residual;
    }
    const Eigen::Quaterniond turn = state.cam_from_world.rotation * given_.rotation.conjugate();
    const Vector3d turned = LogQuaternion(turn.w(), turn.x(), turn.y(), turn.z()) / kTurnRad;
    const Vector3d shifted = (CameraCentre(state.cam_from_world) - CameraCentre(given_)) / shift_;
    cost += turned.squaredNorm() + shifted.squaredNorm();
    for (int k = 0; k < 3; ++k) {
      normal->matrix(k, k) += 1 / (kTurnRad * kTurnRad);
      normal->matrix(3 + k, 3 + k) += 1 / (shift_ * shift_);
    }
    normal->gradient.head<3>() += turned / kTurnRad;
    normal->gradient.segment<3>(3) += shifted / shift_;
    return cost;
  }

  const Camera& camera_;
  const Rigid3& given_;
  const Eigen::Vector4d& axis_;
  const RimPrior& rim_;
  double shift_ = 0;
};

}  // namespace

namespace {

Eigen::Vector4d AxisOf(const TurntableScene& scene) {
  const Vector3d& along = scene.axis.direction;
  // Where it meets the plane z = 0.
  const Vector3d foot = scene.axis.point - scene.axis.point.z() / along.z() * along;
  return {along.x() / along.z(), along.y() / along.z(), foot.x(), foot.y()};
}

const View* ViewOf(const RimPrior& rim, const ScanFeatures& features, const TurntableScene& scene) {
  const std::string& name = features.images[static_cast<size_t>(rim.image)].name;
  for (const View& view : scene.views) {
    if (view.name == name) return &view;
  }
  return nullptr;
}

}  // namespace

void MoveToRims(const std::vector<RimPrior>& rims, const ScanFeatures& features, TurntableScene* scene) {
  const Eigen::Vector4d axis = AxisOf(*scene);
  for (const RimPrior& rim : rims) {
    const View* const seen = ViewOf(rim, features, *scene);
    const Camera* const camera = seen != nullptr ? scene->FindCamera(seen->camera_id) : nullptr;
    if (camera == nullptr) continue;
    const Rigid3 before = seen->cam_from_world;
    const std::optional<Rigid3> after = NearestPose(*camera, before, axis, rim).Find();
    if (!after) continue;
    const Rigid3 after_from_before = *after * before.Inverse();
    const int station = seen->station;
    for (View& view : scene->views) {
      if (view.station == station) view.cam_from_world = after_from_before * view.cam_from_world;
    }
  }
}

double RimErrorPx(const std::vector<RimPrior>& rims, const ScanFeatures& features,
                  const TurntableScene& scene) {
  const Eigen::Vector4d axis = AxisOf(scene);
  double squares = 0;
  double num = 0;
  for (const RimPrior& rim : rims) {
    const View* const seen = ViewOf(rim, features, scene);
    const Camera* const camera = seen != nullptr ? scene.FindCamera(seen->camera_id) : nullptr;
    if (camera == nullptr) continue;
    const std::optional<RimCircle> circle = NearestRimCircle(*camera, seen->cam_from_world, axis, rim.places);
    if (!circle) continue;
    for (const Eigen::Vector2d& place : rim.places) {
      const std::optional<RimOffset> offset =
          OffsetFromRim(*camera, seen->cam_from_world, axis, *circle, place);
      if (!offset) continue;
      squares += offset->px * offset->px;
      num += 1;
    }
  }
  return num > 0 ? std::sqrt(squares / num) : 0;
}

}  // namespace s2gs
