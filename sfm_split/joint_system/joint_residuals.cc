#include "sfm_split/joint_system/joint_residuals.h"

#include <utility>

#include "sfm_split/base/statistics.h"
#include "sfm_split/joint_system/reprojection_cost.h"
#include "sfm_split/scene/projection_jacobians.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

}  // namespace

JointResiduals MeasureJointResiduals(const JointProblem& problem) {
  JointResiduals all;
  for (const bool of_object : {true, false}) {
    const JointBody& body = of_object ? problem.object : problem.background;
    for (const JointObservation& observation : body.observations) {
      if (!observation.active) continue;
      const JointImage& image = problem.images[observation.image];
      Vector3d x = body.points[observation.point];
      if (of_object) x = problem.WorldFromObject(observation.image) * x;
      Vector2d xy;
      Vector2d residual = Vector2d::Constant(ReprojectionCost::kBehindCameraError);
      const Camera& camera = problem.cameras[image.camera];
      if (ProjectWithJacobians(camera.model, camera.params.data(), problem.cam_from_world[image.pose] * x,
                               &xy, nullptr, nullptr)) {
        residual = xy - observation.xy;
      }
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
