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

JointResiduals MeasureJointResiduals(const JointProblem& problem) {
  JointResiduals all;
  const std::vector<Rigid3> world_from_object = problem.WorldFromObjects();
  for (const bool of_object : {true, false}) {
    const JointBody& body = of_object ? problem.object : problem.background;
    std::vector<Vector2d> residuals(body.observations.size());
    ParallelFor(static_cast<int64_t>(residuals.size()), 0, kAtOnce, [&](int64_t k) {
      const JointObservation& observation = body.observations[static_cast<size_t>(k)];
      if (!observation.active) return;
      const JointImage& image = problem.images[observation.image];
      Vector3d x = body.points[observation.point];
      if (of_object) x = world_from_object[observation.image] * x;
      Vector2d xy;
      Vector2d residual = Vector2d::Constant(ReprojectionCost::kBehindCameraError);
      const Camera& camera = problem.cameras[image.camera];
      if (ProjectWithJacobians(camera.model, camera.params.data(), problem.cam_from_world[image.pose] * x,
                               &xy, nullptr, nullptr)) {
        residual = xy - observation.xy;
      }
      residuals[static_cast<size_t>(k)] = residual;
    });
    for (size_t k = 0; k < residuals.size(); ++k) {
      const JointObservation& observation = body.observations[k];
      if (!observation.active) continue;
      (of_object ? all.object_squares : all.background_squares) += residuals[k].squaredNorm();
      ++(of_object ? all.object : all.background);
      all.coordinates.push_back(residuals[k].x() / observation.spread);
      all.coordinates.push_back(residuals[k].y() / observation.spread);
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
