#include "sfm_split/split/picture_comparison.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <bitset>
#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/matching/picture_noise.h"

namespace s2gs {
namespace {

constexpr int kTileSide = 24;        // a multiple of JPEG's blocks, whose edges unrelated tiles share, too
constexpr int kCoarseFactor = 4;     // of the pictures that large shifts are looked for in
constexpr int kCoarseTileSide = 12;  // [px there]
constexpr int kSearchRadius = 4;     // around the coarse shift, which is known to 2 px [px]
constexpr double kBlurPx = 0.8;      // of both pictures before they are compared, against aliasing
constexpr double kMaxSigmaPx = 0.1;  // of a textured tile's displacement
// Independent values among a tile's gradients: blurred noise is one within 4 pi blur^2 pixels.
constexpr double kIndependent = 2.0 * kTileSide * kTileSide / (4 * kPi * kBlurPx * kBlurPx);
constexpr double kSigmaFloorPx = 0.05;   // a parabola's error through three correlations
constexpr double kMaxResidualPx = 0.35;  // of an agreeing tile; what a tripod moved by 1/200 shows is over 1
constexpr double kNullQuantile = 0.95;   // of unrelated tiles' best correlations
constexpr double kLeastCorrelation = 0.5;  // lower ones say nothing: a debt, chosen and not derived
constexpr double kLargestThreshold = 0.9;  // unrelated tiles that correlate better are one pattern
constexpr int kMaxNullTiles = 64;          // evenly chosen, of which unrelated correlations are taken
constexpr int kMinTextured = 8;            // fewer tiles tell no shift: a debt, chosen and not derived
constexpr int kMinAgreeing = 6;            // a debt, chosen and not derived: kMaxLogChance is what proves
constexpr double kMaxLogChance = -14;      // one in a million
constexpr int kGridSize = 8;  // cells along each side of a photo, that say how far agreement spreads

// Number of parameters of the camera's motion in pictures: none, a shift, an affine map, a homography.
constexpr std::array<int, 4> kModels = {0, 2, 6, 8};

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

Eigen::Vector2d Residual(const Eigen::Matrix3d& H, const TileMatch& tile) {
  const Eigen::Vector3d mapped = H * tile.centre.homogeneous();
  return mapped.hnormalized() - tile.centre - tile.displacement;
}

double Bound(const TileMatch& tile) { return std::max(kMaxResidualPx, 3 * tile.sigma_px); }

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

// The summit of a paraboloid through the 3 x 3 correlations around the largest; false at the search's border
// and on ridges.
// \param curvature  at the summit, along the flatter axis [1/px^2].
bool Summit(const std::vector<double>& surface, int radius, double* correlation, double* curvature,
            Eigen::Vector2d* at) {
  const int side = 2 * radius + 1;
  const auto best = std::max_element(surface.begin(), surface.end()) - surface.begin();
  const int x = static_cast<int>(best) % side;
  const int y = static_cast<int>(best) / side;
  if (x == 0 || y == 0 || x == side - 1 || y == side - 1) return false;
  const auto c = [&](int dx, int dy) { return surface[static_cast<size_t>(y + dy) * side + x + dx]; };
  // Least squares over the nine.
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
  Eigen::Matrix2d hessian;
  const double cross = (c(1, 1) - c(-1, 1) - c(1, -1) + c(-1, -1)) / 4;
  hessian << sxx / 3, cross, cross, syy / 3;
  const Eigen::Vector2d gradient(sx / 6, sy / 6);
  if (hessian.trace() >= 0 || hessian.determinant() <= 1e-8) return false;
  const Eigen::Vector2d offset = -hessian.inverse() * gradient;
  if (offset.cwiseAbs().maxCoeff() > 1) return false;
  *correlation = *(surface.begin() + best);
  *curvature = -Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(hessian).eigenvalues().maxCoeff();
  *at = Eigen::Vector2d(x - radius, y - radius) + offset;
  return true;
}

}  // namespace

GreyPicture PictureFor(const Eigen::Vector2i& photo_size) {
  GreyPicture picture;
  picture.photo_size = photo_size;
  const double factor = std::min(1.0, static_cast<double>(kPictureSidePx) / photo_size.maxCoeff());
  picture.width = std::max(1, static_cast<int>(std::lround(factor * photo_size.x())));
  picture.height = std::max(1, static_cast<int>(std::lround(factor * photo_size.y())));
  return picture;
}

PictureStandard::PictureStandard(const GreyPicture& picture, double max_shake_px, double min_share,
                                 int min_cells)
    : width_(picture.width),
      height_(picture.height),
      max_shake_px_(max_shake_px / picture.Scale().maxCoeff()),
      min_share_(min_share),
      min_cells_(min_cells),
      fine_(MakeLevel(picture, 1)),
      coarse_(MakeLevel(picture, kCoarseFactor)),
      tiles_(MakeTiles(fine_, kTileSide)),
      coarse_tiles_(MakeTiles(coarse_, kCoarseTileSide)) {
  FindUniqueTiles();
}

// Of the fine tiles.
void PictureStandard::FindUniqueTiles() {
  constexpr int kSide = 2 * kSearchRadius + 1;  // of the square that is searched
  std::vector<double> surface;
  for (Tile& tile : tiles_) {
    double correlation = 0;
    double curvature = 0;
    if (!Correlate(fine_, tile, fine_, {tile.x, tile.y}, kTileSide, kSearchRadius, &surface) ||
        !Summit(surface, kSearchRadius, &correlation, &curvature, &tile.own_summit))
      continue;
    tile.is_unique = true;
    for (int y = 0; y < kSide; ++y) {
      for (int x = 0; x < kSide; ++x) {
        const double here = surface[static_cast<size_t>(y) * kSide + x];
        if ((x == kSearchRadius && y == kSearchRadius) || here < kLargestThreshold) continue;
        bool is_top = true;
        for (int v = std::max(0, y - 1); v <= std::min(kSide - 1, y + 1); ++v) {
          for (int u = std::max(0, x - 1); u <= std::min(kSide - 1, x + 1); ++u)
            is_top &= surface[static_cast<size_t>(v) * kSide + u] <= here;
        }
        tile.is_unique &= !is_top;
      }
    }
  }
}

PictureStandard::Level PictureStandard::MakeLevel(const GreyPicture& picture, int factor) {
  const cv::Mat bytes(picture.height, picture.width, CV_8UC1, const_cast<uint8_t*>(picture.grey.data()));
  cv::Mat grey;
  bytes.convertTo(grey, CV_32F);
  Level level;
  level.noise = PictureNoise(grey);
  if (factor > 1) {
    const cv::Size size(std::max(1, grey.cols / factor), std::max(1, grey.rows / factor));
    cv::resize(grey, grey, size, 0, 0, cv::INTER_AREA);
    level.noise = std::max(kLeastPictureNoise, level.noise / factor);
  }
  cv::GaussianBlur(grey, grey, {0, 0}, kBlurPx);
  level.gx = Array::Zero(grey.rows, grey.cols);
  level.gy = Array::Zero(grey.rows, grey.cols);
  for (int y = 1; y + 1 < grey.rows; ++y) {
    for (int x = 1; x + 1 < grey.cols; ++x) {
      level.gx(y, x) = 0.5F * (grey.at<float>(y, x + 1) - grey.at<float>(y, x - 1));
      level.gy(y, x) = 0.5F * (grey.at<float>(y + 1, x) - grey.at<float>(y - 1, x));
    }
  }
  return level;
}

std::vector<PictureStandard::Tile> PictureStandard::MakeTiles(const Level& level, int side) {
  std::vector<Tile> tiles;
  const auto num_x = static_cast<int>(level.gx.cols()) / side;
  const auto num_y = static_cast<int>(level.gx.rows()) / side;
  const int left = (static_cast<int>(level.gx.cols()) - num_x * side) / 2;
  const int top = (static_cast<int>(level.gx.rows()) - num_y * side) / 2;
  for (int y = 0; y < num_y; ++y) {
    for (int x = 0; x < num_x; ++x) {
      Tile tile;
      tile.x = left + x * side;
      tile.y = top + y * side;
      const auto gx = level.gx.block(tile.y, tile.x, side, side);
      const auto gy = level.gy.block(tile.y, tile.x, side, side);
      const double xx = gx.square().sum();
      const double yy = gy.square().sum();
      const double xy = (gx * gy).sum();
      tile.energy = xx + yy;
      tile.least_texture = 0.5 * (xx + yy - std::hypot(xx - yy, 2 * xy));
      tiles.push_back(tile);
    }
  }
  return tiles;
}

bool PictureStandard::Correlate(const Level& first, const Tile& tile, const Level& second,
                                const Eigen::Vector2i& place, int side, int radius,
                                std::vector<double>* surface) {
  surface->clear();
  if (place.x() < radius || place.y() < radius || place.x() + side + radius > second.gx.cols() ||
      place.y() + side + radius > second.gx.rows() || tile.energy <= 0)
    return false;
  const auto gx1 = first.gx.block(tile.y, tile.x, side, side);
  const auto gy1 = first.gy.block(tile.y, tile.x, side, side);
  for (int dy = -radius; dy <= radius; ++dy) {
    for (int dx = -radius; dx <= radius; ++dx) {
      const auto gx2 = second.gx.block(place.y() + dy, place.x() + dx, side, side);
      const auto gy2 = second.gy.block(place.y() + dy, place.x() + dx, side, side);
      const double energy = (gx2.square() + gy2.square()).sum();
      const double product = (gx1 * gx2 + gy1 * gy2).sum();
      surface->push_back(energy > 0 ? product / std::sqrt(energy * tile.energy) : 0.0);
    }
  }
  return true;
}

Eigen::Vector2i PictureStandard::CoarseShift(const Level& other) const {
  const int radius = static_cast<int>(std::ceil(max_shake_px_ / kCoarseFactor));
  const int side = 2 * radius + 1;
  std::vector<double> sum(static_cast<size_t>(side) * side, 0.0);
  std::vector<double> surface;
  for (const Tile& tile : coarse_tiles_) {
    if (!Correlate(coarse_, tile, other, {tile.x, tile.y}, kCoarseTileSide, radius, &surface)) continue;
    // Tiles that are found again count far more than what chance correlates.
    for (size_t k = 0; k < sum.size(); ++k) sum[k] += std::pow(std::max(0.0, surface[k]), 4);
  }
  const auto best = static_cast<int>(std::max_element(sum.begin(), sum.end()) - sum.begin());
  return kCoarseFactor * Eigen::Vector2i(best % side - radius, best / side - radius);
}

double PictureStandard::NullCorrelation(const Level& other, const Eigen::Vector2i& shift) const {
  std::vector<double> best;
  std::vector<double> surface;
  const size_t num = tiles_.size();
  const size_t stride = std::max<size_t>(1, num / kMaxNullTiles);
  for (size_t t = 0; t < num; t += stride) {
    if (std::sqrt(2.0) * fine_.noise > kMaxSigmaPx * std::sqrt(tiles_[t].least_texture)) continue;
    const Tile& elsewhere = tiles_[(t + num / 2 + 1) % num];
    if (!Correlate(fine_, tiles_[t], other, Eigen::Vector2i(elsewhere.x, elsewhere.y) + shift, kTileSide,
                   kSearchRadius, &surface))
      continue;
    best.push_back(*std::max_element(surface.begin(), surface.end()));
  }
  if (best.empty()) return kLeastCorrelation;
  std::sort(best.begin(), best.end());
  const double quantile = best[static_cast<size_t>(kNullQuantile * static_cast<double>(best.size() - 1))];
  return std::clamp(quantile, kLeastCorrelation, kLargestThreshold);
}

void PictureStandard::MatchTiles(const Level& other, const Eigen::Vector2i& shift, double least_correlation,
                                 PictureComparison* comparison) const {
  std::vector<double> surface;
  const double noise = std::hypot(fine_.noise, other.noise);
  comparison->tiles.reserve(tiles_.size());
  for (const Tile& tile : tiles_) {
    TileMatch match;
    match.centre = Eigen::Vector2d(tile.x + 0.5 * kTileSide, tile.y + 0.5 * kTileSide);
    match.displacement.setZero();
    const double sigma = noise / std::sqrt(std::max(tile.least_texture, 1e-6));
    match.is_textured = sigma <= kMaxSigmaPx && tile.is_unique;
    if (match.is_textured && Correlate(fine_, tile, other, Eigen::Vector2i(tile.x, tile.y) + shift, kTileSide,
                                       kSearchRadius, &surface)) {
      ++comparison->num_textured;
      Eigen::Vector2d at;
      double curvature = 0;
      if (Summit(surface, kSearchRadius, &match.correlation, &curvature, &at)) {
        match.displacement = shift.cast<double>() + at - tile.own_summit;
        match.is_found = match.correlation >= least_correlation;
        // Of the maximum of a correlation: what does not correlate is noise, of whatever kind.
        const double rho = std::clamp(match.correlation, 0.01, 0.9999);
        match.sigma_px = std::hypot(
            kSigmaFloorPx, std::sqrt((1 - rho * rho) / (kIndependent * rho * std::max(curvature, 1e-3))));
      }
    }
    comparison->tiles.push_back(match);
  }
}

// The simplest motion that explains the tiles, each model started from where the simpler one ended.
void PictureStandard::FitMotion(PictureComparison* comparison) const {
  std::vector<const TileMatch*> found;
  for (const TileMatch& tile : comparison->tiles) {
    if (tile.is_found) found.push_back(&tile);
  }
  if (found.empty()) return;
  Motion motion;
  motion.centre = 0.5 * Eigen::Vector2d(width_, height_);
  motion.unit = std::max(width_, height_);
  motion.p.head<2>() = DensestDisplacement(found) / motion.unit;
  std::vector<const TileMatch*> inliers = Inliers(motion.Homography(), found, 1.0);
  double best = Criterion(Eigen::Matrix3d::Identity(), found, 0);
  for (const int num_parameters : kModels) {
    if (num_parameters == 0 || static_cast<int>(inliers.size()) < 2 * num_parameters) continue;
    bool fits = true;
    for (const double bound : {1.0, 0.7, 0.5, 0.0, 0.0}) {
      fits = fits && Fit(inliers, num_parameters, &motion);
      if (!fits) break;
      inliers = Inliers(motion.Homography(), found, bound);
      fits = static_cast<int>(inliers.size()) >= 2 * num_parameters;
    }
    if (!fits) break;
    const Eigen::Matrix3d H = motion.Homography();
    const double cost = Criterion(H, found, num_parameters);
    if (cost < best) {
      best = cost;
      comparison->second_from_first = H;
    }
    inliers = Inliers(H, found, 1.0);
  }
}

PictureComparison PictureStandard::CompareAt(const Level& other, const Eigen::Vector2i& shift) const {
  PictureComparison comparison;
  MatchTiles(other, shift, NullCorrelation(other, shift), &comparison);
  if (comparison.num_textured < kMinTextured) return comparison;
  FitMotion(&comparison);
  std::bitset<static_cast<size_t>(kGridSize) * kGridSize> cells;
  const double max_shake = max_shake_px_ + kMaxResidualPx;
  for (TileMatch& tile : comparison.tiles) {
    if (!tile.is_found || tile.displacement.cwiseAbs().maxCoeff() > max_shake ||
        Residual(comparison.second_from_first, tile).norm() > Bound(tile))
      continue;
    tile.agrees = true;
    ++comparison.num_agreeing;
    const auto x = static_cast<size_t>(tile.centre.x() * kGridSize / width_);
    const auto y = static_cast<size_t>(tile.centre.y() * kGridSize / height_);
    cells.set(y * kGridSize + x);
  }
  comparison.num_cells = static_cast<int>(cells.count());
  const double window = 2.0 * kSearchRadius + 1;
  const double chance =
      (1 - kNullQuantile) * std::min(1.0, kPi * kMaxResidualPx * kMaxResidualPx / (window * window));
  const bool is_still =
      comparison.num_agreeing >= kMinAgreeing && comparison.num_cells >= min_cells_ &&
      comparison.num_agreeing >= min_share_ * comparison.num_textured &&
      LogPoissonTail(comparison.num_agreeing, chance * comparison.num_textured) <= kMaxLogChance;
  comparison.verdict = is_still ? PictureComparison::Verdict::kStill : PictureComparison::Verdict::kMoved;
  return comparison;
}

PictureComparison PictureStandard::CompareWith(const GreyPicture& other) const {
  if (other.width != width_ || other.height != height_) {
    PictureComparison comparison;
    comparison.verdict = PictureComparison::Verdict::kMoved;
    return comparison;
  }
  const Level fine = MakeLevel(other, 1);
  PictureComparison unshifted = CompareAt(fine, Eigen::Vector2i::Zero());
  const Eigen::Vector2i shift = CoarseShift(MakeLevel(other, kCoarseFactor));
  if (shift.isZero()) return unshifted;
  PictureComparison shifted = CompareAt(fine, shift);
  return shifted.num_agreeing > unshifted.num_agreeing ? shifted : unshifted;
}

}  // namespace s2gs
