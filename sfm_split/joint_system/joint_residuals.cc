#include "sfm_split/joint_system/joint_residuals.h"

#include <cstdint>
#include <utility>

#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/joint_system/reprojection_cost.h"
#include "sfm_split/scene/projection_jacobians.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr int64_t kAtOnce = 4096;  // observations: some .2 ms

}  // namespace

std::vector<std::optional<Vector2d>> ReprojectionErrors(const JointProblem& problem, bool of_object) {
  const std::vector<Rigid3> world_from_object = problem.WorldFromObjects();
  const JointBody& body = of_object ? problem.object : problem.background;
  std::vector<std::optional<Vector2d>> errors(body.observations.size());
  ParallelFor(static_cast<int64_t>(errors.size()), 0, kAtOnce, [&](int64_t k) {
    const JointObservation& observation = body.observations[static_cast<size_t>(k)];
    if (!observation.active) return;
    const JointImage& image = problem.images[observation.image];
    Vector3d x = body.points[observation.point];
    if (of_object) x = world_from_object[observation.image] * x;
    const Camera& camera = problem.cameras[image.camera];
    Vector2d xy;
    if (ProjectWithJacobians(camera.model, camera.params.data(), problem.cam_from_world[image.pose] * x, &xy,
                             nullptr, nullptr)) {
      errors[static_cast<size_t>(k)] = xy - observation.xy;
    }
  });
  return errors;
}

JointResiduals MeasureJointResiduals(const JointProblem& problem) {
  JointResiduals all;
  for (const bool of_object : {true, false}) {
    const JointBody& body = of_object ? problem.object : problem.background;
    const std::vector<std::optional<Vector2d>> errors = ReprojectionErrors(problem, of_object);
    for (size_t k = 0; k < errors.size(); ++k) {
      const JointObservation& observation = body.observations[k];
      if (!observation.active) continue;
      const Vector2d residual = errors[k].value_or(Vector2d::Constant(ReprojectionCost::kBehindCameraError));
      (of_object ? all.object_squares : all.background_squares) += residual.squaredNorm();
      ++(of_object ? all.object : all.background);
      all.coordinates.push_back(residual.x() / observation.spread);
      all.coordinates.push_back(residual.y() / observation.spread);
    }
  }
  return all;
}

double RobustSigmaPx(std::vector<double> residuals, int parameters) {
  if (residuals.empty()) return 0;
  for (double& r : residuals) r = std::abs(r);
  const double count = static_cast<double>(residuals.size());
  return kSigmaOfMad * UpperMedian(std::move(residuals)) *
         std::sqrt(count / std::max(1.0, count - parameters));
}

}  // namespace s2gs
