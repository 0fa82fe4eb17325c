#include "sfm_split/joint_system/wobble_prior.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <vector>

#include "sfm_split/joint_system/pose_information.h"

namespace s2gs {
namespace {

using Eigen::Vector3d;
using Matrix6 = Eigen::Matrix<double, 6, 6>;

constexpr int kRounds = 50;               // of expectation and maximisation, at most
constexpr size_t kLeastPoses = 3;         // fewer tell no variance beside their mean
constexpr double kLeastVariance = 1e-12;  // a millionth: no table is better
constexpr double kSettled = 1e-3;         // relative change of a standard deviation

// A variance from deviations that are themselves known only so well.
class Moments {
 public:
  /// Of a deviation under the prior: its square and its own variance.
  void AddPosterior(double squared, double known) {
    sum_ += squared + known;
    weight_ += 1;
  }
  /// Of one that the keypoints alone tell: what is over its own variance, by how well it tells that.
  void AddMeasured(double squared, double known, double variance) {
    const double weight = 1 / ((variance + known) * (variance + known));
    sum_ += weight * (squared - known);
    weight_ += weight;
  }
  double Variance() const { return std::max(weight_ > 0 ? sum_ / weight_ : 0, kLeastVariance); }

 private:
  double sum_ = 0;
  double weight_ = 0;
};

}  // namespace

std::optional<WobblePrior> FitWobble(const JointProblem& problem, const JointOptions& options,
                                     double sigma_px) {
  const std::vector<PoseInformation> information = InformationOfPoses(problem, options, sigma_px);
  // The reference's pose is what all others are told from.
  std::vector<WobbleOfPose> deviations;
  std::vector<Matrix6> known;
  for (size_t i = 0; i < problem.images.size(); ++i) {
    if (static_cast<int>(i) == problem.reference || !(information[i].information.trace() > 0)) continue;
    deviations.push_back(
        DeviationFromTurn(problem.AxisDirection(), problem.AxisPoint(), problem.images[i].world_from_object));
    known.push_back(information[i].information);
  }
  if (deviations.size() < kLeastPoses) return std::nullopt;
  const Vector3d axis = problem.AxisDirection();
  const Eigen::Matrix3d across = Eigen::Matrix3d::Identity() - axis * axis.transpose();
  double tilt = 0;
  double shift = 0;
  for (const WobbleOfPose& wobble : deviations) {
    tilt += wobble.tilt_rad.squaredNorm();
    shift += wobble.shift.squaredNorm();
  }
  const auto num = static_cast<double>(deviations.size());
  double tilt_variance = std::max(tilt / (2 * num), kLeastVariance);
  double shift_variance = std::max(shift / (3 * num), kLeastVariance);
  const bool has_prior = problem.priors.wobble.has_value();
  for (int round = 0; round < kRounds; ++round) {
    Moments tilts;
    Moments shifts;
    for (size_t k = 0; k < known.size(); ++k) {
      Matrix6 information_of_pose = known[k];
      if (has_prior) {
        information_of_pose.topLeftCorner<3, 3>() += across / tilt_variance;
        information_of_pose.bottomRightCorner<3, 3>() += Eigen::Matrix3d::Identity() / shift_variance;
      }
      const Matrix6 covariance = information_of_pose.completeOrthogonalDecomposition().pseudoInverse();
      const double tilt_known = (across * covariance.topLeftCorner<3, 3>()).trace() / 2;
      const double shift_known = covariance.bottomRightCorner<3, 3>().trace() / 3;
      if (has_prior) {
        tilts.AddPosterior(deviations[k].tilt_rad.squaredNorm() / 2, tilt_known);
        shifts.AddPosterior(deviations[k].shift.squaredNorm() / 3, shift_known);
      } else {
        tilts.AddMeasured(deviations[k].tilt_rad.squaredNorm() / 2, tilt_known, tilt_variance);
        shifts.AddMeasured(deviations[k].shift.squaredNorm() / 3, shift_known, shift_variance);
      }
    }
    const double next_tilt = tilts.Variance();
    const double next_shift = shifts.Variance();
    const bool is_settled = std::abs(next_tilt - tilt_variance) <= kSettled * tilt_variance &&
                            std::abs(next_shift - shift_variance) <= kSettled * shift_variance;
    tilt_variance = next_tilt;
    shift_variance = next_shift;
    if (is_settled) break;
  }
  return WobblePrior{std::sqrt(tilt_variance), std::sqrt(shift_variance), {}};
}

}  // namespace s2gs
