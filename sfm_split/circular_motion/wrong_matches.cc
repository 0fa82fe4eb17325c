#include "sfm_split/circular_motion/wrong_matches.h"

#include <algorithm>
#include <cstddef>

#include "sfm_split/base/angles.h"

namespace s2gs {
namespace {

constexpr double kEvenShare = 0.2;    // of wrong matches that fall anywhere
constexpr size_t kMaxMoves = 1000;    // that tell the density; each in both directions
constexpr size_t kNearestMoves = 12;  // the area that they take tells the density, to 1 / sqrt(12)

}  // namespace

WrongMatches::WrongMatches(const std::vector<Eigen::Vector2d>& far_moves, double extent) : extent_(extent) {
  const size_t stride = 1 + far_moves.size() / kMaxMoves;
  for (size_t k = 0; k < far_moves.size(); k += stride) {
    moves_.push_back(far_moves[k]);
    moves_.emplace_back(-far_moves[k]);
  }
  squared_.resize(moves_.size());
}

double WrongMatches::Chance(const Eigen::Vector2d& move) const {
  const double even = 1 / (4 * extent_ * extent_);
  if (moves_.size() <= kNearestMoves) return 1 / extent_;
  for (size_t k = 0; k < moves_.size(); ++k) squared_[k] = (move - moves_[k]).squaredNorm();
  const auto nearest = squared_.begin() + static_cast<std::ptrdiff_t>(kNearestMoves);
  std::nth_element(squared_.begin(), nearest, squared_.end());
  const double area = kPi * std::max(*nearest, 1.0);
  const double density = static_cast<double>(kNearestMoves) / (static_cast<double>(moves_.size()) * area);
  return extent_ * (kEvenShare * even + (1 - kEvenShare) * density);
}

}  // namespace s2gs
