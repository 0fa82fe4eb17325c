#include "sfm_split/joint_system/smooth_wobble.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "sfm_split/base/rotation.h"
#include "sfm_split/joint_system/pose_information.h"

namespace s2gs {
namespace {

using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;
using Parts = WobbleHarmonics::Parts;
using Terms = WobbleHarmonics::Terms;
using Information = Eigen::Matrix<double, WobbleHarmonics::kParts, WobbleHarmonics::kParts>;

constexpr int kCoefficients = WobbleHarmonics::kCoefficients;  // of one station
constexpr size_t kLeastImages = 2 * WobbleHarmonics::kTerms;   // as many tell how they scatter
constexpr double kLeastVariance = 1e-12;                       // a millionth: no table is better
constexpr double kMostVariance = 1;                            // a radian, the unit of length
constexpr int kGrid = 28;       // variances that are tried at first: a factor of 2.7 from one to the next
constexpr int kSearches = 4;    // of one variance and then the other
constexpr int kBisections = 6;  // of a variance's place on the grid: to 2 %

// A pose's deviation from a pure turn and what keypoints say of it, whatever the turn.
struct Deviation {
  double angle_rad;
  Parts at;
  Parts gradient;
  Information information;
};

// x_in_world = exp(w) R x + t, and the axis goes through the world's origin (BringIntoConventions).
Eigen::Matrix<double, 6, WobbleHarmonics::kParts> PoseByParts(const Vector3d& axis) {
  Eigen::Matrix<double, 6, WobbleHarmonics::kParts> by_parts;
  by_parts.setZero();
  const auto [across, beside] = AcrossAxis(axis);
  by_parts.col(0).head<3>() = across;
  by_parts.col(1).head<3>() = beside;
  by_parts.bottomRightCorner<3, 3>().setIdentity();
  return by_parts;
}

// Of a station's images that see the object, without the reference, whose pose is given.
std::vector<Deviation> DeviationsOf(const JointProblem& problem, const std::vector<int>& images,
                                    const std::vector<PoseInformation>& poses) {
  const Vector3d axis = problem.AxisDirection();
  const auto by_parts = PoseByParts(axis);
  Eigen::Matrix<double, 6, 1> by_turn = Eigen::Matrix<double, 6, 1>::Zero();
  by_turn.head<3>() = axis;
  std::vector<Deviation> deviations;
  for (const int i : images) {
    const PoseInformation& pose = poses[static_cast<size_t>(i)];
    const double of_turn = by_turn.dot(pose.information * by_turn);
    if (i == problem.reference || !(of_turn > 0)) continue;
    const Rigid3 world_from_object = problem.WorldFromObject(i);
    const WobbleOfPose wobble = DeviationFromTurn(axis, problem.AxisPoint(), world_from_object);
    Deviation deviation;
    deviation.angle_rad = AngleAbout(axis, world_from_object.rotation.toRotationMatrix());
    const auto [across, beside] = AcrossAxis(axis);
    deviation.at << across.dot(wobble.tilt_rad), beside.dot(wobble.tilt_rad), wobble.shift;
    // The angle is unknown beside them.
    const Parts with_turn = by_parts.transpose() * pose.information * by_turn;
    deviation.information =
        by_parts.transpose() * pose.information * by_parts - with_turn * with_turn.transpose() / of_turn;
    deviation.gradient =
        by_parts.transpose() * pose.gradient - with_turn * (by_turn.dot(pose.gradient) / of_turn);
    deviations.push_back(deviation);
  }
  return deviations;
}

// d (parts at an image) / d (coefficients of harmonics, row by row).
MatrixXd ByHarmonics(double angle_rad) {
  const Terms terms = WobbleHarmonics::TermsAt(angle_rad);
  MatrixXd by = MatrixXd::Zero(WobbleHarmonics::kParts, kCoefficients);
  for (int part = 0; part < WobbleHarmonics::kParts; ++part)
    by.row(part).segment<WobbleHarmonics::kTerms>(part * WobbleHarmonics::kTerms) = terms.transpose();
  return by;
}

// Deviations about harmonics, with an error of its own for each: the errors' variances, the coefficients and,
// but for what is the same for all of these, the logarithm of the likelihood, all errors integrated out.
struct Fit {
  Parts variances;
  VectorXd coefficients;
  double log_likelihood = 0;
};

class Fitting {
 public:
  explicit Fitting(const std::vector<Deviation>& deviations) : deviations_(deviations) {
    for (const Deviation& deviation : deviations) by_harmonics_.push_back(ByHarmonics(deviation.angle_rad));
  }

  // The likeliest: both tilts scatter alike, and so do the shifts.
  Fit Run() const {
    double logs[2] = {std::log(kLeastVariance), std::log(kLeastVariance)};
    Fit best = FitAt(logs[0], logs[1]);
    for (int search = 0; search < kSearches; ++search) {
      for (double& one : logs) {
        const double here = one;
        const auto ask = [&](double place) {
          one = place;
          Fit fit = FitAt(logs[0], logs[1]);
          const bool is_better = fit.log_likelihood > best.log_likelihood;
          if (is_better) best = std::move(fit);
          return is_better;
        };
        const double step = std::log(kMostVariance / kLeastVariance) / kGrid;
        double at = here;
        for (int k = 0; k <= kGrid; ++k) {
          const double place = std::log(kLeastVariance) + k * step;
          if (ask(place)) at = place;
        }
        double width = step;
        for (int k = 0; k < kBisections; ++k) {
          width *= 0.5;
          for (const double place : {at - width, at + width}) {
            if (ask(place)) at = place;
          }
        }
        one = at;
      }
    }
    return best;
  }

 private:
  // Least squares with the weights W = P - P (I + P)^-1 P of what keypoints (I) and the scatter (P) leave,
  // and W m = W d + P (I + P)^-1 g for what keypoints alone say, m = d + I^-1 g, which need not be finite.
  Fit FitAt(double log_of_tilt, double log_of_shift) const {
    Fit fit;
    fit.variances << Eigen::Vector2d::Constant(std::exp(log_of_tilt)),
        Vector3d::Constant(std::exp(log_of_shift));
    const Information precision = fit.variances.cwiseInverse().asDiagonal();
    MatrixXd normal = MatrixXd::Zero(kCoefficients, kCoefficients);
    VectorXd right = VectorXd::Zero(kCoefficients);
    for (size_t k = 0; k < deviations_.size(); ++k) {
      const Deviation& deviation = deviations_[k];
      const Information known = (deviation.information + precision).inverse();
      const Information weight = precision - precision * known * precision;
      normal += by_harmonics_[k].transpose() * weight * by_harmonics_[k];
      right +=
          by_harmonics_[k].transpose() * (weight * deviation.at + precision * known * deviation.gradient);
    }
    fit.coefficients = normal.completeOrthogonalDecomposition().solve(right);
    for (size_t k = 0; k < deviations_.size(); ++k) {
      const Deviation& deviation = deviations_[k];
      const Parts beside = deviation.at - by_harmonics_[k] * fit.coefficients;
      const Information sum = deviation.information + precision;
      const Parts asked = deviation.information * beside + deviation.gradient;
      // Of m about the mean, whose variance is I^-1 + P^-1.
      fit.log_likelihood -= 0.5 * (std::log(sum.determinant()) - std::log(precision.determinant()) +
                                   beside.dot(deviation.information * beside) +
                                   2 * beside.dot(deviation.gradient) - asked.dot(sum.ldlt().solve(asked)));
    }
    return fit;
  }

  const std::vector<Deviation>& deviations_;
  std::vector<MatrixXd> by_harmonics_;
};

}  // namespace

std::vector<WobbleHarmonics> NoHarmonics(const JointProblem& problem) {
  std::map<int, WobbleHarmonics> of_pose;
  for (size_t i = 0; i < problem.images.size(); ++i)
    of_pose[problem.images[i].pose].images.push_back(static_cast<int>(i));
  std::vector<WobbleHarmonics> result;
  for (auto& [pose, wobble] : of_pose) {
    if (wobble.images.size() >= kLeastImages) result.push_back(std::move(wobble));
  }
  return result;
}

std::optional<WobblePrior> FitHarmonics(const JointProblem& problem, const JointOptions& options,
                                        double sigma_px) {
  const std::vector<PoseInformation> poses = InformationOfPoses(problem, options, sigma_px);
  WobblePrior prior;
  Parts variances = Parts::Zero();
  double num = 0;
  for (WobbleHarmonics& station : NoHarmonics(problem)) {
    const std::vector<Deviation> deviations = DeviationsOf(problem, station.images, poses);
    if (deviations.size() < kLeastImages) continue;
    const Fit fit = Fitting(deviations).Run();
    const auto count = static_cast<double>(deviations.size());
    variances += count * fit.variances;
    num += count;
    for (int k = 0; k < kCoefficients; ++k)
      station.coefficients(k / WobbleHarmonics::kTerms, k % WobbleHarmonics::kTerms) = fit.coefficients(k);
    prior.harmonics.push_back(std::move(station));
  }
  if (prior.harmonics.empty()) return std::nullopt;
  prior.sigma_tilt_rad = std::sqrt(variances(0) / num);
  prior.sigma_shift = std::sqrt(variances(2) / num);
  return prior;
}

}  // namespace s2gs
