#include "sfm_split/joint_system/track_weights.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <numeric>
#include <vector>

#include "sfm_split/joint_system/joint_system.h"
#include "sfm_split/joint_system/prepare_and_add.h"
#include "sfm_split/joint_system/reduced_system.h"
#include "sfm_split/solvers/eigen_solvers.h"

namespace s2gs {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

// Of all information about a parameter, or of an error's variance: less of it is rounding.
constexpr double kRounding = 1e-9;
constexpr int kCorrelations = 50;  // that are tried beside none

// What some of the points say of some of the parameters: second derivatives of the cost over its curvature,
// and its gradient.
struct Say {
  MatrixXd information;
  VectorXd gradient;
  int num_points = 0;

  explicit Say(Eigen::Index size) : information(MatrixXd::Zero(size, size)), gradient(VectorXd::Zero(size)) {}

  void AddPoint(const std::vector<int>& columns, const VectorXd& its_gradient,
                const MatrixXd& its_information) {
    gradient(columns) += its_gradient;
    information(columns, columns) += its_information;
    ++num_points;
  }
  void Add(const Say& other, double weight) {
    gradient += weight * other.gradient;
    information += weight * other.information;
  }
};

MatrixXd Inverse(const MatrixXd& positive) {
  const VectorXd unit =
      positive.diagonal().cwiseMax(std::numeric_limits<double>::min()).cwiseSqrt().cwiseInverse();
  const MatrixXd scaled = unit.asDiagonal() * positive * unit.asDiagonal();
  return unit.asDiagonal() * scaled.ldlt().solve(MatrixXd::Identity(scaled.rows(), scaled.cols())) *
         unit.asDiagonal();
}

// The logarithm of a normal density, but for its constant.
double LogNormal(const VectorXd& error, const MatrixXd& covariance) {
  const VectorXd unit =
      covariance.diagonal().cwiseMax(std::numeric_limits<double>::min()).cwiseSqrt().cwiseInverse();
  const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(
      MatrixXd(unit.asDiagonal() * covariance * unit.asDiagonal()));
  const VectorXd along = eigen.eigenvectors().transpose() * (unit.asDiagonal() * error);
  const auto variances = eigen.eigenvalues().array().max(kRounding);
  return unit.array().log().sum() - 0.5 * (variances.log() + along.array().square() / variances).sum();
}

double Weight(double correlation, int num_points) {
  return 1 / (1 + correlation * std::max(0, num_points - 1));
}

// The median of what a value may be, of which the first is as likely as the others together, and these alike,
// before it is asked. \param values  ascending.
template <typename LogLikelihood>
double Median(const std::vector<double>& values, const LogLikelihood& log_likelihood) {
  std::vector<double> odds;
  odds.reserve(values.size());
  for (const double value : values) odds.push_back(log_likelihood(value));
  const double best = *std::max_element(odds.begin(), odds.end());
  for (double& of_value : odds) of_value = std::exp(of_value - best);
  odds[0] *= static_cast<double>(values.size() - 1);
  const double half = std::accumulate(odds.begin(), odds.end(), 0.0) / 2;
  double sum = 0;
  for (size_t k = 0; k < values.size(); ++k) {
    sum += odds[k];
    if (sum >= (1 - kRounding) * half) return values[k];
  }
  return values.back();
}

// What classes of a problem's points say of what all photos share.
class ClassComparison {
 public:
  ClassComparison(const JointProblem& problem, const JointSystem& system, const ReducedSystem& reduced,
                  int num_threads)
      : known_(0) {
    FindShared(problem, system, reduced);
    const auto size = reduced.s.rows();
    const double curvature = CurvatureShare(reduced.loss);
    Say priors(size);
    priors.information = SumPriors(system, reduced).information / curvature;
    priors.information.diagonal() += kRounding * (reduced.diagonal + priors.information.diagonal());
    std::vector<Say> classes(TrackWeights::kClasses, Say(size));
    Say background(size);
    MatrixXd of_points = MatrixXd::Zero(size, size);
    struct Prepared {
      VectorXd gradient;
      MatrixXd information;
    };
    const auto prepare = [&](size_t i) {
      const PointScore& score = reduced.scores[i];
      return Prepared{score.Gradient(), score.by_cameras.transpose() * score.by_cameras};
    };
    PrepareAndAdd(reduced.scores.size(), num_threads, prepare, [&](size_t i, const Prepared* point) {
      const PointScore& score = reduced.scores[i];
      // At the optimum all gradients' sum is 0: what points leave is the priors'.
      priors.gradient(score.columns) -= point->gradient;
      if (score.ring < 0) {
        // Their weights make the keypoints of a station one measurement.
        background.AddPoint(score.columns, point->gradient, point->information);
        return;
      }
      const VectorXd unweighed = point->gradient / score.weight;
      const int of_class = TrackWeights::ClassOf(static_cast<int>(score.cells.size()));
      classes[static_cast<size_t>(of_class)].AddPoint(score.columns, unweighed,
                                                      point->information / score.weight);
      of_points(score.columns, score.columns) += unweighed * unweighed.transpose();
    });
    Say object(size);
    for (const Say& of_class : classes) object.Add(of_class, 1);
    for (const Say& of_class : classes) classes_.push_back(OfShared(of_class, priors));
    known_ = OfShared(background, priors);
    known_.Add(Pick(priors), 1);
    const MatrixXd by_all = ByAll(object, priors);
    const MatrixXd stated = by_all.transpose() * object.information * by_all;
    point_variance_ = (Inverse(stated) * by_all.transpose() * of_points * by_all).trace() /
                      static_cast<double>(shared_.size());
  }

  int num_shared() const { return static_cast<int>(shared_.size()); }
  int NumPoints(int of_class) const { return classes_[static_cast<size_t>(of_class)].num_points; }
  // Of the gradient over the information, in the mean of parameters, as points as clusters show it.
  double point_variance() const { return point_variance_; }

  // The restricted likelihood's logarithm, from the longest tracks down: how far what each class says is from
  // what those before it say.
  /// \param variance  of the gradient over the information.
  double LogLikelihood(double correlation, double variance) const {
    Say before = known_;
    double sum = 0;
    for (auto here = classes_.rbegin(); here != classes_.rend(); ++here) {
      if (here->num_points == 0) continue;
      const double weight = Weight(correlation, here->num_points);
      const MatrixXd inverse = Inverse(before.information);
      // The class' gradient at the others' optimum.
      const VectorXd error = here->gradient - here->information * inverse * before.gradient;
      sum += LogNormal(
          error, variance * (here->information * inverse * here->information + here->information / weight));
      before.Add(*here, weight);
    }
    return sum;
  }

 private:
  void FindShared(const JointProblem& problem, const JointSystem& system, const ReducedSystem& reduced) {
    const int first_camera = system.IntrinsicsBlock(0);
    const int last_camera = first_camera + static_cast<int>(problem.cameras.size());
    for (size_t k = 0; k < reduced.columns.size(); ++k) {
      const int block = reduced.columns[k].block;
      const bool of_camera = block >= first_camera && block < last_camera;
      const bool of_axis = !problem.free_object && block == system.AxisBlock();
      (of_camera || of_axis ? shared_ : others_).push_back(static_cast<int>(k));
    }
  }

  Say Pick(const Say& say) const {
    Say picked(0);
    picked.information = say.information(shared_, shared_);
    picked.gradient = say.gradient(shared_);
    picked.num_points = say.num_points;
    return picked;
  }

  // How all parameters move with the shared ones when the others stay at the optimum.
  MatrixXd ByAll(const Say& say, const Say& priors) const {
    const MatrixXd of_others = say.information(others_, others_) + priors.information(others_, others_);
    MatrixXd by_all = MatrixXd::Zero(say.gradient.size(), static_cast<Eigen::Index>(shared_.size()));
    by_all(shared_, Eigen::all).setIdentity();
    by_all(others_, Eigen::all) = -of_others.ldlt().solve(MatrixXd(say.information(others_, shared_)));
    return by_all;
  }

  // With the other parameters eliminated, of which priors say something, too.
  Say OfShared(const Say& say, const Say& priors) const {
    Say result = Pick(say);
    if (others_.empty() || say.num_points == 0) return result;
    const MatrixXd by_all = ByAll(say, priors);
    result.information = say.information(shared_, Eigen::all) * by_all;
    result.gradient = by_all.transpose() * say.gradient;
    return result;
  }

  std::vector<int> shared_;
  std::vector<int> others_;
  std::vector<Say> classes_;
  Say known_;  // by the background and by priors
  double point_variance_ = 0;
};

}  // namespace

int TrackWeights::ClassOf(int keypoints) {
  int c = 0;
  while (c + 1 < kClasses && (2 << c) < keypoints) ++c;
  return c;
}

TrackWeights FitTrackWeights(const JointProblem& problem, const JointOptions& options, double sigma_px) {
  TrackWeights all_alike;
  const JointSystem system(problem, options, true);
  int free = 0;
  for (const JointSystem::Block& block : system.blocks())
    free += block.used ? static_cast<int>(block.free.size()) : 0;
  if (free == 0 || free > options.max_dense_parameters) return all_alike;
  const std::unique_ptr<ceres::LossFunction> loss = MakeLoss(options);
  const ReducedSystem reduced = Reduce(problem, system, loss.get(), options.num_threads);
  const ClassComparison comparison(problem, system, reduced, options.num_threads);
  if (comparison.num_shared() == 0) return all_alike;
  const double curvature = CurvatureShare(reduced.loss);
  const double variance = std::max(
      NormalVarianceFactor(loss.get(), reduced.loss, sigma_px) * sigma_px * sigma_px * curvature * curvature,
      comparison.point_variance());
  TrackWeights median;
  int num_points = 0;
  for (int c = 0; c < TrackWeights::kClasses; ++c) num_points += comparison.NumPoints(c);
  // From where all points together count as half of them, to 1.
  std::vector<double> correlations = {0};
  correlations.reserve(kCorrelations + 1);
  for (int k = kCorrelations - 1; k >= 0; --k)
    correlations.push_back(std::pow(std::max(2, num_points), -static_cast<double>(k) / (kCorrelations - 1)));
  median.correlation = Median(
      correlations, [&](double correlation) { return comparison.LogLikelihood(correlation, variance); });
  for (int c = 0; c < TrackWeights::kClasses; ++c)
    median.of_class[static_cast<size_t>(c)] = Weight(median.correlation, comparison.NumPoints(c));
  return median;
}

void ApplyTrackWeights(const TrackWeights& weights, JointProblem* problem) {
  JointBody& body = problem->object;
  std::vector<int> keypoints(body.points.size(), 0);
  for (const JointObservation& o : body.observations)
    keypoints[static_cast<size_t>(o.point)] += o.active ? 1 : 0;
  for (JointObservation& o : body.observations) {
    if (!o.active) continue;
    const int c = TrackWeights::ClassOf(keypoints[static_cast<size_t>(o.point)]);
    o.weight = weights.of_class[static_cast<size_t>(c)];
  }
}

}  // namespace s2gs
