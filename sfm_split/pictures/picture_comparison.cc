#include "sfm_split/pictures/picture_comparison.h"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <bitset>
#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/matching/picture_noise.h"
#include "sfm_split/pictures/correlation_summit.h"
#include "sfm_split/solvers/eigen_solvers.h"

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
constexpr double kSigmaFloorPx = 0.05;  // a parabola's error through three correlations
// A ridge of correlations is sampled a little too high where it passes a pixel's middle, which moves its
// summit along it, by as much more as it is flatter there: per ratio of the curvatures. Measured on rendered
// photos whose cameras were turned: .06 to .08 px at ratios of 7 to 15, .3 at 15 to 40, 1.8 above.
constexpr double kLeakPx = 0.015;
constexpr double kNullQuantile = 0.95;     // of unrelated tiles' best correlations
constexpr double kLeastCorrelation = 0.5;  // lower ones say nothing: a debt, chosen and not derived
constexpr double kLargestThreshold = 0.9;  // unrelated tiles that correlate better are one pattern
constexpr int kMaxNullTiles = 64;          // evenly chosen, of which unrelated correlations are taken
constexpr int kMinTextured = 8;            // fewer tiles tell no shift: a debt, chosen and not derived
constexpr int kMinAgreeing = 6;            // a debt, chosen and not derived: kMaxLogChance is what proves
// Where an edge lies across itself says nothing of what it is an edge of: any place in reach is as likely.
constexpr double kChanceOfEdge = 2 * kMaxResidualPx / (2 * kSearchRadius + 1);
// Edges' worth that agree along the direction that knows least: by chance once in 2,000.
constexpr double kMinAcross = 3;
constexpr int kGridSize = 8;  // cells along each side of a photo, that say how far agreement spreads

// Standard deviation of the place of a correlation's maximum [px]: what does not correlate is noise, of
// whatever kind.
double SigmaOf(double correlation, double curvature) {
  const double rho = std::clamp(correlation, 0.01, 0.9999);
  return std::hypot(kSigmaFloorPx,
                    std::sqrt((1 - rho * rho) / (kIndependent * rho * std::max(curvature, 1e-3))));
}

// Cells of the grid over a picture that agreeing tiles lie in.
int CellsOfAgreeing(const std::vector<TileMatch>& tiles, int width, int height) {
  std::bitset<static_cast<size_t>(kGridSize) * kGridSize> cells;
  for (const TileMatch& tile : tiles) {
    if (!tile.agrees) continue;
    const auto x = static_cast<size_t>(tile.centre.x() * kGridSize / width);
    const auto y = static_cast<size_t>(tile.centre.y() * kGridSize / height);
    cells.set(y * kGridSize + x);
  }
  return static_cast<int>(cells.count());
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
                                 int min_cells, bool to_border)
    : width_(picture.width),
      height_(picture.height),
      max_shake_px_(max_shake_px / picture.Scale().maxCoeff()),
      min_share_(min_share),
      min_cells_(min_cells),
      fine_(MakeLevel(picture, 1)),
      coarse_(MakeLevel(picture, kCoarseFactor)),
      tiles_(MakeTiles(fine_, kTileSide, to_border ? kSearchRadius : 0)),
      coarse_tiles_(MakeTiles(coarse_, kCoarseTileSide, 0)) {
  FindUniqueTiles();
  FindEdges();
}

// Of the fine tiles.
void PictureStandard::FindUniqueTiles() {
  constexpr int kSide = 2 * kSearchRadius + 1;  // of the square that is searched
  std::vector<double> surface;
  for (Tile& tile : tiles_) {
    double correlation = 0;
    double curvature = 0;
    // Farther off along the ridge than what agrees: it tells its place across it alone.
    if (tile.LeakPx() > kMaxResidualPx) continue;
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

// Of the fine tiles.
void PictureStandard::FindEdges() {
  constexpr int kSide = 2 * kSearchRadius + 1;  // of the square that is searched
  const double least = 2 * fine_.noise * fine_.noise / (kMaxSigmaPx * kMaxSigmaPx);
  std::vector<double> surface;
  for (Tile& tile : tiles_) {
    double correlation = 0;
    double curvature = 0;
    const bool is_ridge = tile.least_texture < least || tile.LeakPx() > kMaxResidualPx;
    if (!is_ridge || tile.most_texture < least ||
        !Correlate(fine_, tile, fine_, {tile.x, tile.y}, kTileSide, kSearchRadius, &surface) ||
        !SummitAlong(surface, kSearchRadius, tile.normal, &correlation, &curvature, &tile.own_place))
      continue;
    tile.is_edge = true;
    // Stripes and the two sides of a line look alike a few pixels beside.
    for (int y = 0; y < kSide; ++y) {
      for (int x = 0; x < kSide; ++x) {
        const double across = tile.normal.dot(Eigen::Vector2d(x - kSearchRadius, y - kSearchRadius));
        tile.is_edge &= std::abs(across) < 0.5 * kSearchRadius ||
                        surface[static_cast<size_t>(y) * kSide + x] < kLargestThreshold;
      }
    }
  }
}

double PictureStandard::Tile::LeakPx() const {
  return kLeakPx * most_texture / std::max(least_texture, 1e-6);
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

std::vector<PictureStandard::Tile> PictureStandard::MakeTiles(const Level& level, int side, int margin) {
  std::vector<Tile> tiles;
  const auto num_x = (static_cast<int>(level.gx.cols()) - 2 * margin) / side;
  const auto num_y = (static_cast<int>(level.gx.rows()) - 2 * margin) / side;
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
      tile.most_texture = tile.energy - tile.least_texture;
      const double direction = 0.5 * std::atan2(2 * xy, xx - yy);
      tile.normal = {std::cos(direction), std::sin(direction)};
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

void PictureStandard::MatchTiles(const Level& other, const Eigen::Vector2i& shift,
                                 const std::vector<char>& is_passing, double least_correlation,
                                 PictureComparison* comparison) const {
  std::vector<double> surface;
  const double noise = std::hypot(fine_.noise, other.noise);
  comparison->tiles.reserve(tiles_.size());
  for (size_t t = 0; t < tiles_.size(); ++t) {
    const Tile& tile = tiles_[t];
    TileMatch match;
    match.centre = Eigen::Vector2d(tile.x + 0.5 * kTileSide, tile.y + 0.5 * kTileSide);
    match.displacement.setZero();
    const double sigma = noise / std::sqrt(std::max(tile.least_texture, 1e-6));
    match.is_textured = sigma <= kMaxSigmaPx && tile.is_unique && (is_passing.empty() || is_passing[t] == 0);
    if (match.is_textured && Correlate(fine_, tile, other, Eigen::Vector2i(tile.x, tile.y) + shift, kTileSide,
                                       kSearchRadius, &surface)) {
      ++comparison->num_textured;
      Eigen::Vector2d at;
      double curvature = 0;
      if (Summit(surface, kSearchRadius, &match.correlation, &curvature, &at)) {
        match.displacement = shift.cast<double>() + at - tile.own_summit;
        match.is_found = match.correlation >= least_correlation;
        match.sigma_px = std::hypot(SigmaOf(match.correlation, curvature), tile.LeakPx());
      }
    }
    comparison->tiles.push_back(match);
  }
}

bool PictureStandard::StandsStillByTiles(PictureComparison* comparison) const {
  const double max_shake = max_shake_px_ + kMaxResidualPx;
  for (TileMatch& tile : comparison->tiles) {
    tile.agrees = tile.is_found && tile.displacement.cwiseAbs().maxCoeff() <= max_shake &&
                  Residual(comparison->second_from_first, tile).norm() <= Bound(tile);
    comparison->num_agreeing += tile.agrees ? 1 : 0;
  }
  comparison->num_cells = CellsOfAgreeing(comparison->tiles, width_, height_);
  const double window = 2.0 * kSearchRadius + 1;
  const double chance =
      (1 - kNullQuantile) * std::min(1.0, kPi * kMaxResidualPx * kMaxResidualPx / (window * window));
  comparison->log_chance = LogPoissonTail(comparison->num_agreeing, chance * comparison->num_textured);
  return comparison->num_agreeing >= kMinAgreeing && comparison->num_cells >= min_cells_ &&
         comparison->num_agreeing >= min_share_ * comparison->num_textured &&
         comparison->log_chance <= kMaxLogChance;
}

// Edges along which the other picture was found again: their places across themselves.
void PictureStandard::MatchEdges(const Level& other, const Eigen::Vector2i& shift,
                                 PictureComparison* comparison) const {
  std::vector<double> surface;
  for (size_t t = 0; t < tiles_.size(); ++t) {
    const Tile& tile = tiles_[t];
    TileMatch& match = comparison->tiles[t];
    if (!tile.is_edge || !Correlate(fine_, tile, other, Eigen::Vector2i(tile.x, tile.y) + shift, kTileSide,
                                    kSearchRadius, &surface))
      continue;
    match.is_edge = true;
    match.normal = tile.normal;
    ++comparison->num_edges;
    double curvature = 0;
    double place = 0;
    if (!SummitAlong(surface, kSearchRadius, tile.normal, &match.correlation, &curvature, &place) ||
        match.correlation < kLeastCorrelation)
      continue;
    match.displacement = (tile.normal.dot(shift.cast<double>()) + place - tile.own_place) * tile.normal;
    match.sigma_px = SigmaOf(match.correlation, curvature);
  }
}

// What agrees, and its share of what there is, are asked for along the direction that knows least: a camera
// that moved along a shelf's edge leaves that edge where it was, and no other.
bool PictureStandard::StandsStillByEdges(const Level& other, const Eigen::Vector2i& shift,
                                         PictureComparison* comparison) const {
  // A motion of tiles that prove nothing is that of what turns, as likely as not.
  Eigen::Matrix3d& motion = comparison->second_from_first;
  motion.setIdentity();
  motion.topRightCorner<2, 1>() = shift.cast<double>();
  comparison->log_chance = 0;
  MatchEdges(other, shift, comparison);
  if (comparison->num_edges == 0) return false;
  const CameraTurn turn = FitCameraTurn(comparison->tiles, motion, kSearchRadius, width_, height_);
  motion = turn.second_from_first;
  const double max_shake = max_shake_px_ + kMaxResidualPx;
  Eigen::Matrix2d all = Eigen::Matrix2d::Zero();
  Eigen::Matrix2d agreeing = Eigen::Matrix2d::Zero();
  int num = 0;
  double by_chance = 0;  // of the edges: as an edge was placed, so wide is what it agrees with
  for (TileMatch& tile : comparison->tiles) {
    if (!tile.is_textured && !tile.is_edge) continue;
    all += Told(tile);
    tile.agrees = IsSeen(tile) && Moved(motion, tile).cwiseAbs().maxCoeff() <= max_shake &&
                  Residual(motion, tile).norm() <= Bound(tile);
    if (tile.is_edge) by_chance += std::min(1.0, 2 * Bound(tile) / (2 * kSearchRadius + 1));
    if (!tile.agrees) continue;
    agreeing += Told(tile);
    ++num;
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> number(agreeing, Eigen::EigenvaluesOnly);
  if (number.eigenvalues().minCoeff() < kMinAcross) return false;
  const Eigen::GeneralizedSelfAdjointEigenSolver<Eigen::Matrix2d> share(agreeing, all,
                                                                        Eigen::EigenvaluesOnly);
  comparison->num_cells = CellsOfAgreeing(comparison->tiles, width_, height_);
  double& log_chance = comparison->log_chance;
  log_chance = LogPoissonTail(num, by_chance);
  // A shift was chosen among as many places as differ, here or by the coarse pictures, and so were a roll and
  // a growth of what lies at the picture's border.
  const int num_chosen = std::max(turn.num_parameters, shift.isZero() ? 0 : 2);
  log_chance -= num_chosen * std::log(kChanceOfEdge);
  return share.eigenvalues().minCoeff() >= min_share_ && comparison->num_cells >= min_cells_ &&
         log_chance <= kMaxLogChance;
}

PictureComparison PictureStandard::CompareAt(const Level& other, const Eigen::Vector2i& shift,
                                             const std::vector<char>& is_passing) const {
  PictureComparison comparison;
  MatchTiles(other, shift, is_passing, NullCorrelation(other, shift), &comparison);
  const bool can_tell = comparison.num_textured >= kMinTextured;
  if (can_tell) comparison.second_from_first = FitTileMotion(comparison.tiles, width_, height_);
  if ((can_tell && StandsStillByTiles(&comparison)) || StandsStillByEdges(other, shift, &comparison)) {
    comparison.verdict = PictureComparison::Verdict::kStill;
  } else if (can_tell) {
    comparison.verdict = PictureComparison::Verdict::kMoved;
  }
  return comparison;
}

PictureComparison PictureStandard::CompareWith(const GreyPicture& other,
                                               const std::vector<char>& is_passing) const {
  if (other.width != width_ || other.height != height_) {
    PictureComparison comparison;
    comparison.verdict = PictureComparison::Verdict::kMoved;
    return comparison;
  }
  const Level fine = MakeLevel(other, 1);
  PictureComparison unshifted = CompareAt(fine, Eigen::Vector2i::Zero(), is_passing);
  const Eigen::Vector2i shift = CoarseShift(MakeLevel(other, kCoarseFactor));
  if (shift.isZero()) return unshifted;
  PictureComparison shifted = CompareAt(fine, shift, is_passing);
  const auto is_still = [](const PictureComparison& c) {
    return c.verdict == PictureComparison::Verdict::kStill;
  };
  if (is_still(shifted) != is_still(unshifted)) return is_still(shifted) ? shifted : unshifted;
  return shifted.num_agreeing > unshifted.num_agreeing ? shifted : unshifted;
}

}  // namespace s2gs
