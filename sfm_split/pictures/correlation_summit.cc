#include "sfm_split/pictures/correlation_summit.h"

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "sfm_split/solvers/eigen_solvers.h"

namespace s2gs {
namespace {

struct Paraboloid {
  Eigen::Vector2d gradient;
  Eigen::Matrix2d hessian;
};

// Of least squares through the 3 x 3 correlations around a place.
Paraboloid ParaboloidAround(const std::vector<double>& surface, int side, const Eigen::Vector2i& at) {
  const auto c = [&](int dx, int dy) {
    return surface[static_cast<size_t>(at.y() + dy) * side + at.x() + dx];
  };
  double sx = 0;
  double sy = 0;
  double sxx = 0;
  double syy = 0;
  for (int k = -1; k <= 1; ++k) {
    sx += c(1, k) - c(-1, k);
    sy += c(k, 1) - c(k, -1);
    sxx += c(1, k) - 2 * c(0, k) + c(-1, k);
    syy += c(k, 1) - 2 * c(k, 0) + c(k, -1);
  }
  Paraboloid around;
  const double cross = (c(1, 1) - c(-1, 1) - c(1, -1) + c(-1, -1)) / 4;
  around.hessian << sxx / 3, cross, cross, syy / 3;
  around.gradient = {sx / 6, sy / 6};
  return around;
}

}  // namespace

bool Summit(const std::vector<double>& surface, int radius, double* correlation, double* curvature,
            Eigen::Vector2d* at) {
  const int side = 2 * radius + 1;
  const auto best = std::max_element(surface.begin(), surface.end()) - surface.begin();
  const int x = static_cast<int>(best) % side;
  const int y = static_cast<int>(best) / side;
  if (x == 0 || y == 0 || x == side - 1 || y == side - 1) return false;
  const auto [gradient, hessian] = ParaboloidAround(surface, side, {x, y});
  if (hessian.trace() >= 0 || hessian.determinant() <= 1e-8) return false;
  const Eigen::Vector2d offset = -hessian.inverse() * gradient;
  if (offset.cwiseAbs().maxCoeff() > 1) return false;
  *correlation = *(surface.begin() + best);
  *curvature = -Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(hessian).eigenvalues().maxCoeff();
  *at = Eigen::Vector2d(x - radius, y - radius) + offset;
  return true;
}

bool SummitAlong(const std::vector<double>& surface, int radius, const Eigen::Vector2d& normal,
                 double* correlation, double* curvature, double* at) {
  const int side = 2 * radius + 1;
  const double kReachPx = std::sqrt(0.5);  // every line passes a pixel's middle by no more
  *correlation = -1;
  Eigen::Vector2i best = Eigen::Vector2i::Zero();
  for (int y = 0; y < side; ++y) {
    for (int x = 0; x < side; ++x) {
      const Eigen::Vector2d beside(x - radius, y - radius);
      const double here = surface[static_cast<size_t>(y) * side + x];
      if (std::abs(beside.x() * normal.y() - beside.y() * normal.x()) > kReachPx || here <= *correlation)
        continue;
      *correlation = here;
      best = {x, y};
    }
  }
  if (best.minCoeff() == 0 || best.maxCoeff() == side - 1) return false;
  const Paraboloid around = ParaboloidAround(surface, side, best);
  *curvature = -normal.dot(around.hessian * normal);
  if (*curvature <= 0) return false;
  const double offset = normal.dot(around.gradient) / *curvature;
  *at = normal.dot((best.array() - radius).matrix().cast<double>()) + offset;
  return std::abs(offset) <= 1;
}

}  // namespace s2gs
