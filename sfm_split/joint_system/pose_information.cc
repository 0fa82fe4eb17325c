#include "sfm_split/joint_system/pose_information.h"

#include <algorithm>
#include <array>
#include <memory>

#include "sfm_split/joint_system/joint_system.h"

namespace s2gs {

std::vector<PoseInformation> InformationOfPoses(const JointProblem& problem, const JointOptions& options,
                                                double sigma_px) {
  const JointSystem system(problem, options, true);
  const std::unique_ptr<ceres::LossFunction> loss = MakeLoss(options);
  std::vector<PoseInformation> poses(problem.images.size());
  for (const JointSystem::Term& term : system.terms()) {
    if (!term.of_object) continue;
    Eigen::Matrix<double, 2, 6, Eigen::RowMajor> by_pose;
    std::array<double*, 5> jacobians{};
    jacobians[1] = by_pose.data();
    Eigen::Vector2d residual;
    term.cost.Evaluate(term.values.data(), residual.data(), jacobians.data());
    double rho[3] = {0, 1, 0};
    if (loss) loss->Evaluate(residual.squaredNorm(), rho);
    const double weight = std::max(0.0, rho[1]) / (sigma_px * sigma_px);
    poses[static_cast<size_t>(term.image)].information += weight * by_pose.transpose() * by_pose;
  }
  return poses;
}

}  // namespace s2gs
