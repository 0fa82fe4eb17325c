#include "sfm_split/pictures/tile_motion.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>

#include "sfm_split/solvers/eigen_solvers.h"

namespace s2gs {

Eigen::Vector2d Moved(const Eigen::Matrix3d& H, const TileMatch& tile) {
  return (H * tile.centre.homogeneous()).hnormalized() - tile.centre;
}

Eigen::Matrix2d Told(const TileMatch& tile) {
  if (!tile.is_edge) return Eigen::Matrix2d::Identity();
  return tile.normal * tile.normal.transpose();
}

Eigen::Vector2d Residual(const Eigen::Matrix3d& H, const TileMatch& tile) {
  return Told(tile) * (Moved(H, tile) - tile.displacement);
}

double Bound(const TileMatch& tile) { return std::max(kMaxResidualPx, 3 * tile.sigma_px); }

bool IsSeen(const TileMatch& tile) { return tile.is_found || (tile.is_edge && tile.sigma_px > 0); }

namespace {

// Number of parameters of the camera's motion in pictures: a shift, an affine map, a homography.
constexpr std::array<int, 3> kModels = {2, 6, 8};

// The motion's effect is linear in its parameters: d = a + A x + x' (c . x), in units of the picture's side.
Eigen::Matrix<double, 2, 8> Design(const Eigen::Vector2d& x, const Eigen::Vector2d& moved) {
  Eigen::Matrix<double, 2, 8> design;
  design << 1, 0, x.x(), x.y(), 0, 0, moved.x() * x.x(), moved.x() * x.y(),  //
      0, 1, 0, 0, x.x(), x.y(), moved.y() * x.x(), moved.y() * x.y();
  return design;
}

struct Motion {
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  double unit = 1;
  Eigen::Matrix<double, 8, 1> p = Eigen::Matrix<double, 8, 1>::Zero();

  Eigen::Matrix3d Homography() const {
    Eigen::Matrix3d H;
    H << 1 + p[2], p[3], p[0], p[4], 1 + p[5], p[1], -p[6], -p[7], 1;
    Eigen::Matrix3d normalise;
    normalise << 1 / unit, 0, -centre.x() / unit, 0, 1 / unit, -centre.y() / unit, 0, 0, 1;
    return normalise.inverse() * H * normalise;
  }
};

std::vector<const TileMatch*> Inliers(const Eigen::Matrix3d& H, const std::vector<const TileMatch*>& found,
                                      double bound_px) {
  std::vector<const TileMatch*> inliers;
  for (const TileMatch* tile : found) {
    if (Residual(H, *tile).norm() <= std::max(bound_px, Bound(*tile))) inliers.push_back(tile);
  }
  return inliers;
}

bool Fit(const std::vector<const TileMatch*>& tiles, int num_parameters, Motion* motion) {
  Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(num_parameters, num_parameters);
  Eigen::VectorXd right = Eigen::VectorXd::Zero(num_parameters);
  for (const TileMatch* tile : tiles) {
    const Eigen::Vector2d x = (tile->centre - motion->centre) / motion->unit;
    const Eigen::Vector2d d = tile->displacement / motion->unit;
    const Eigen::MatrixXd design = Design(x, x + d).leftCols(num_parameters);
    const double weight = 1 / (tile->sigma_px * tile->sigma_px);
    normal += weight * design.transpose() * design;
    right += weight * design.transpose() * d;
  }
  const Eigen::LDLT<Eigen::MatrixXd> solver(normal);
  if (solver.info() != Eigen::Success || solver.rcond() < 1e-12) return false;
  motion->p.setZero();
  motion->p.head(num_parameters) = solver.solve(right);
  return motion->p.allFinite();
}

std::vector<const TileMatch*> SeenTiles(const std::vector<TileMatch>& tiles) {
  std::vector<const TileMatch*> seen;
  for (const TileMatch& tile : tiles) {
    if (IsSeen(tile)) seen.push_back(&tile);
  }
  return seen;
}

// Minus twice the log-likelihood of all found tiles, with outliers' share of it bounded, and what its
// parameters cost by Schwarz's criterion.
double Criterion(const Eigen::Matrix3d& H, const std::vector<const TileMatch*>& found, int num_parameters) {
  double cost = num_parameters * std::log(2.0 * static_cast<double>(found.size()));
  for (const TileMatch* tile : found) {
    const double limit = Bound(*tile) / tile->sigma_px;
    cost += std::min(Residual(H, *tile).squaredNorm() / (tile->sigma_px * tile->sigma_px), limit * limit);
  }
  return cost;
}

// The displacement that most tiles have others within a pixel of; the smallest among equals.
Eigen::Vector2d DensestDisplacement(const std::vector<const TileMatch*>& found) {
  Eigen::Vector2d best = Eigen::Vector2d::Zero();
  int best_count = -1;
  for (const TileMatch* tile : found) {
    int count = 0;
    for (const TileMatch* other : found)
      count += (other->displacement - tile->displacement).squaredNorm() <= 1.0 ? 1 : 0;
    if (count > best_count ||
        (count == best_count && tile->displacement.squaredNorm() < best.squaredNorm())) {
      best_count = count;
      best = tile->displacement;
    }
  }
  return best;
}

// A shift, a roll about the picture's middle and a growth [px, rad, natural logarithm].
struct Turn {
  Eigen::Vector2d middle;
  Eigen::Vector2d shift = Eigen::Vector2d::Zero();
  double roll = 0;
  double log_zoom = 0;

  Eigen::Matrix3d Homography() const {
    const Eigen::Affine2d T = Eigen::Translation2d(middle + shift) * Eigen::Rotation2Dd(roll) *
                              Eigen::Scaling(std::exp(log_zoom)) * Eigen::Translation2d(-middle);
    return T.matrix();
  }
};

// The shift of a grid as fine as a residual's bound that explains most.
Eigen::Vector2d LikeliestShift(const std::vector<const TileMatch*>& seen, const Eigen::Matrix3d& from,
                               int radius) {
  Eigen::Vector2d best = Eigen::Vector2d::Zero();
  double least = Criterion(from, seen, 0);
  const int steps = static_cast<int>(std::ceil(radius / kMaxResidualPx));
  for (int y = -steps; y <= steps; ++y) {
    for (int x = -steps; x <= steps; ++x) {
      const Eigen::Vector2d d = kMaxResidualPx * Eigen::Vector2d(x, y);
      const double cost = Criterion(Turn{{0, 0}, d, 0}.Homography() * from, seen, 2);
      if (cost < least) {
        least = cost;
        best = d;
      }
    }
  }
  return best;
}

// Least squares over what agrees within falling bounds: of the shift alone (2), of the roll (3) and the
// growth (4), too.
Turn Refined(const std::vector<const TileMatch*>& seen, const Eigen::Matrix3d& from, int num_parameters,
             Turn turn) {
  for (const double bound : {1.0, 0.7, 0.5, 0.0, 0.0}) {
    const Eigen::Matrix3d H = turn.Homography() * from;
    Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(num_parameters, num_parameters);
    Eigen::VectorXd right = Eigen::VectorXd::Zero(num_parameters);
    for (const TileMatch* tile : Inliers(H, seen, num_parameters > 2 ? bound : 0.0)) {
      const Eigen::Vector2d arm = tile->centre + Moved(H, *tile) - turn.middle - turn.shift;
      Eigen::Matrix<double, 2, 4> design;
      design << 1, 0, -arm.y(), arm.x(), 0, 1, arm.x(), arm.y();
      const Eigen::MatrixXd told = Told(*tile) * design.leftCols(num_parameters);
      const double weight = 1 / (tile->sigma_px * tile->sigma_px);
      normal += weight * told.transpose() * told;
      right -= weight * told.transpose() * Residual(H, *tile);
    }
    const Eigen::LDLT<Eigen::MatrixXd> solver(normal);
    if (solver.info() != Eigen::Success || solver.rcond() < 1e-12) break;
    const Eigen::VectorXd step = solver.solve(right);
    turn.shift += step.head<2>();
    if (num_parameters > 2) turn.roll += step(2);
    if (num_parameters > 3) turn.log_zoom += step(3);
  }
  return turn;
}

}  // namespace

Eigen::Matrix3d FitTileMotion(const std::vector<TileMatch>& tiles, int width, int height) {
  std::vector<const TileMatch*> found;
  for (const TileMatch& tile : tiles) {
    if (tile.is_found) found.push_back(&tile);
  }
  Eigen::Matrix3d chosen = Eigen::Matrix3d::Identity();
  if (found.empty()) return chosen;
  double best = Criterion(chosen, found, 0);
  const auto consider = [&](const Eigen::Matrix3d& H, int num_parameters) {
    const double cost = Criterion(H, found, num_parameters);
    if (cost >= best) return;
    best = cost;
    chosen = H;
  };
  Motion motion;
  motion.centre = 0.5 * Eigen::Vector2d(width, height);
  motion.unit = std::max(width, height);
  motion.p.head<2>() = DensestDisplacement(found) / motion.unit;
  const Eigen::Vector2d densest = motion.unit * motion.p.head<2>();
  std::vector<const TileMatch*> inliers = Inliers(motion.Homography(), found, 1.0);
  for (const int num_parameters : kModels) {
    bool fits = static_cast<int>(inliers.size()) >= 2 * num_parameters;
    for (const double bound : {1.0, 0.7, 0.5, 0.0, 0.0}) {
      fits = fits && Fit(inliers, num_parameters, &motion);
      if (!fits) break;
      inliers = Inliers(motion.Homography(), found, bound);
      fits = static_cast<int>(inliers.size()) >= 2 * num_parameters;
    }
    if (fits) consider(motion.Homography(), num_parameters);
    if (!fits && num_parameters > 2) break;
    if (num_parameters == 2) {
      Turn turn{motion.centre, fits ? Eigen::Vector2d(motion.unit * motion.p.head<2>()) : densest};
      for (const int num_of_turn : {3, 4}) {
        turn = Refined(found, Eigen::Matrix3d::Identity(), num_of_turn, turn);
        consider(turn.Homography(), num_of_turn);
      }
    }
    inliers = Inliers(fits ? motion.Homography() : chosen, found, 1.0);
  }
  return chosen;
}

CameraTurn FitCameraTurn(const std::vector<TileMatch>& tiles, const Eigen::Matrix3d& from, int radius,
                         int width, int height) {
  const std::vector<const TileMatch*> seen = SeenTiles(tiles);
  Turn turn{0.5 * Eigen::Vector2d(width, height), LikeliestShift(seen, from, radius), 0};
  CameraTurn chosen{from};
  double least = Criterion(from, seen, 0);
  for (const int num_parameters : {2, 3, 4}) {
    // Less than a residual's bound is no shift: what stays is the likelier for it.
    if (num_parameters == 2 && turn.shift.isZero()) continue;
    turn = Refined(seen, from, num_parameters, turn);
    if (turn.shift.cwiseAbs().maxCoeff() > radius) break;
    const Eigen::Matrix3d H = turn.Homography() * from;
    const double cost = Criterion(H, seen, num_parameters);
    if (cost >= least) continue;
    least = cost;
    chosen = {H, num_parameters};
  }
  return chosen;
}

}  // namespace s2gs
