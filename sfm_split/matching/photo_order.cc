#include "sfm_split/matching/photo_order.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <numeric>

#include "sfm_split/base/error.h"
#include "sfm_split/solvers/eigen_solvers.h"

namespace s2gs {
namespace {

// Of the strongest weight: joins what has nothing in common, so that there is one order of all photos.
constexpr double kLeastWeight = 1e-4;

}  // namespace

std::vector<uint32_t> OrderBySimilarity(const SimilarityMatrix& similarity) {
  S2GS_INVARIANT(similarity.rows() == similarity.cols());
  const Eigen::Index num = similarity.rows();
  std::vector<uint32_t> order(num);
  std::iota(order.begin(), order.end(), 0U);
  if (num < 4) return order;
  Eigen::MatrixXd weight = similarity.cast<double>();
  weight.diagonal().setZero();
  // Photos differ in how much they show: what counts is a photo's share of the best that each of the two has.
  const Eigen::VectorXd best = weight.rowwise().maxCoeff().cwiseMax(1.0);
  for (Eigen::Index i = 0; i < num; ++i) {
    for (Eigen::Index j = 0; j < num; ++j) {
      const double share = weight(i, j) / std::sqrt(best[i] * best[j]);
      weight(i, j) = i == j ? 0 : share * share + kLeastWeight;
    }
  }
  const Eigen::VectorXd root = weight.rowwise().sum().cwiseSqrt().cwiseInverse();
  const Eigen::MatrixXd normalised = root.asDiagonal() * weight * root.asDiagonal();
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(normalised);
  if (solver.info() != Eigen::Success) return order;
  // Eigenvalues ascend; the largest is the constant's.
  const Eigen::VectorXd x = root.cwiseProduct(solver.eigenvectors().col(num - 2));
  const Eigen::VectorXd y = root.cwiseProduct(solver.eigenvectors().col(num - 3));
  std::vector<double> angle(num);
  for (Eigen::Index i = 0; i < num; ++i) angle[i] = std::atan2(y[i], x[i]);
  std::sort(order.begin(), order.end(),
            [&](uint32_t a, uint32_t b) { return angle[a] != angle[b] ? angle[a] < angle[b] : a < b; });
  std::rotate(order.begin(), std::find(order.begin(), order.end(), 0U), order.end());
  return order;
}

}  // namespace s2gs
