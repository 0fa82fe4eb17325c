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

std::vector<const TileMatch*> Inliers(const Eigen::Matrix3d& H, const std::vector<const TileMatch*>& found,
                                      double bound_px) {
  std::vector<const TileMatch*> inliers;
  for (const TileMatch* tile : found) {
    if (Residual(H, *tile).norm() <= std::max(bound_px, Bound(*tile))) inliers.push_back(tile);
  }
  return inliers;
}

template <typename Is>
std::vector<const TileMatch*> TilesThat(const Is& is, const std::vector<TileMatch>& tiles) {
  std::vector<const TileMatch*> result;
  for (const TileMatch& tile : tiles) {
    if (is(tile)) result.push_back(&tile);
  }
  return result;
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

// What a camera shows that turns a little about its centre, to first order: a shift, a roll about the
// picture's middle, the growth of all that a lens shows when it focuses anew, and, the shorter the focal
// length the more, a lean of the shift.
struct Turn {
  Eigen::Vector2d middle;                           // [px]
  double unit = 1;                                  // the picture's longer side [px]
  Eigen::Vector2d shift = Eigen::Vector2d::Zero();  // [px]
  double roll = 0;                                  // [rad]
  double log_zoom = 0;
  double lean = 0;  // the square of the unit over the focal length

  static constexpr int kMaxParameters = 5;

  Turn(int width, int height) : middle(0.5 * width, 0.5 * height), unit(std::max(width, height)) {}

  Eigen::Matrix3d Homography() const {
    const Eigen::Affine2d turned =
        Eigen::Translation2d(middle + shift) * Eigen::Rotation2Dd(roll) * Eigen::Scaling(std::exp(log_zoom));
    Eigen::Matrix3d leant = Eigen::Matrix3d::Identity();
    leant.row(2).head<2>() = -lean / (unit * unit) * shift;
    const Eigen::Affine2d from_middle(Eigen::Translation2d(-middle));
    return turned.matrix() * leant * from_middle.matrix();
  }

  // How a point moves with shift, roll, growth and lean; `arm` is where it is from the shifted middle [px].
  Eigen::Matrix<double, 2, kMaxParameters> Design(const Eigen::Vector2d& arm) const {
    const Eigen::Vector2d at = arm / unit;
    const Eigen::Vector2d leant = shift.dot(at) * at;
    Eigen::Matrix<double, 2, kMaxParameters> design;
    design << 1, 0, -arm.y(), arm.x(), leant.x(), 0, 1, arm.x(), arm.y(), leant.y();
    return design;
  }

  void Add(const Eigen::VectorXd& step) {
    shift += step.head<2>();
    if (step.size() > 2) roll += step(2);
    if (step.size() > 3) log_zoom += step(3);
    if (step.size() > 4) lean += step(4);
  }
};

// The shift of a grid as fine as a residual's bound that explains most.
Eigen::Vector2d LikeliestShift(const std::vector<const TileMatch*>& seen, const Eigen::Matrix3d& from,
                               int radius, Turn turn) {
  Eigen::Vector2d best = Eigen::Vector2d::Zero();
  double least = Criterion(from, seen, 0);
  const int steps = static_cast<int>(std::ceil(radius / kMaxResidualPx));
  for (int y = -steps; y <= steps; ++y) {
    for (int x = -steps; x <= steps; ++x) {
      turn.shift = kMaxResidualPx * Eigen::Vector2d(x, y);
      const double cost = Criterion(turn.Homography() * from, seen, 2);
      if (cost < least) {
        least = cost;
        best = turn.shift;
      }
    }
  }
  return best;
}

// Of residuals that agree, beside each tile's own [px].
using Bounds = std::array<double, 5>;
constexpr Bounds kFalling = {1.0, 0.7, 0.5, 0.0, 0.0};
constexpr Bounds kStrict = {0.0, 0.0, 0.0, 0.0, 0.0};

// Least squares over what agrees within bounds that fall: of the shift alone (2), of the roll (3), the growth
// (4) and the lean (5), too. False where too few agree.
bool Refine(const std::vector<const TileMatch*>& seen, const Eigen::Matrix3d& from, int num_parameters,
            const Bounds& bounds, int least_tiles, Turn* turn) {
  for (const double bound : bounds) {
    const Eigen::Matrix3d H = turn->Homography() * from;
    const std::vector<const TileMatch*> inliers = Inliers(H, seen, bound);
    if (static_cast<int>(inliers.size()) < least_tiles) return false;
    Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(num_parameters, num_parameters);
    Eigen::VectorXd right = Eigen::VectorXd::Zero(num_parameters);
    for (const TileMatch* tile : inliers) {
      const Eigen::Vector2d arm = tile->centre + Moved(H, *tile) - turn->middle - turn->shift;
      const Eigen::MatrixXd told = Told(*tile) * turn->Design(arm).leftCols(num_parameters);
      const double weight = 1 / (tile->sigma_px * tile->sigma_px);
      normal += weight * told.transpose() * told;
      right -= weight * told.transpose() * Residual(H, *tile);
    }
    const Eigen::LDLT<Eigen::MatrixXd> solver(normal);
    if (solver.info() != Eigen::Success || solver.rcond() < 1e-12) return false;
    turn->Add(solver.solve(right));
  }
  return true;
}

// Cameras have no shorter focal lengths than .3 widths.
constexpr double kMaxLean = 1 / (0.3 * 0.3);

}  // namespace

Eigen::Matrix3d FitTileMotion(const std::vector<TileMatch>& tiles, int width, int height) {
  const std::vector<const TileMatch*> found =
      TilesThat([](const TileMatch& tile) { return tile.is_found; }, tiles);
  Eigen::Matrix3d chosen = Eigen::Matrix3d::Identity();
  if (found.empty()) return chosen;
  Turn turn(width, height);
  turn.shift = DensestDisplacement(found);
  double least = Criterion(chosen, found, 0);
  for (int num_parameters = 2; num_parameters <= Turn::kMaxParameters; ++num_parameters) {
    if (!Refine(found, Eigen::Matrix3d::Identity(), num_parameters, kFalling, 2 * num_parameters, &turn))
      break;
    if (turn.lean < 0 || turn.lean > kMaxLean) break;
    const Eigen::Matrix3d H = turn.Homography();
    const double cost = Criterion(H, found, num_parameters);
    if (cost >= least) continue;
    least = cost;
    chosen = H;
  }
  return chosen;
}

CameraTurn FitCameraTurn(const std::vector<TileMatch>& tiles, const Eigen::Matrix3d& from, int radius,
                         int width, int height) {
  const std::vector<const TileMatch*> seen = TilesThat(IsSeen, tiles);
  Turn turn(width, height);
  turn.shift = LikeliestShift(seen, from, radius, turn);
  CameraTurn chosen{from};
  double least = Criterion(from, seen, 0);
  for (const int num_parameters : {2, 3, 4}) {
    // Less than a residual's bound is no shift: what stays is the likelier for it.
    if (num_parameters == 2 && turn.shift.isZero()) continue;
    Refine(seen, from, num_parameters, num_parameters > 2 ? kFalling : kStrict, 0, &turn);
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
