#include "sfm_split/circular_motion/wrong_matches.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <random>

#include "sfm_split/base/angles.h"

namespace s2gs {
namespace {

constexpr size_t kMaxMoves = 1000;    // that tell the density; each in both directions
constexpr size_t kNearestMoves = 12;  // the area that they take tells the density, to 1 / sqrt(12)
constexpr int kDraws = 500;     // of two moves: where a tenth orbits, 99 of 100 times one is of two that do
constexpr double kOrbitPx = 3;  // of a move that a draw explains: twice what outlines are placed to
constexpr double kLeastTurn = 0.1;  // determinant of two turns that tell an orbit
constexpr int kRounds = 20;         // of expectation and maximisation
constexpr double kSigmas = 3;       // all but one in ninety moves of a thing that orbits
constexpr double kCertain = 8;      // e^-8: what is believed against chance
constexpr int kOrbitUnknowns = 6;   // four of the map, a share, a deviation

double EvenDensity(double extent) { return 1 / (4 * extent * extent); }

}  // namespace

Eigen::Vector2d TurnBetween(double angle1_rad, double angle2_rad) {
  return {std::cos(angle2_rad) - std::cos(angle1_rad), std::sin(angle2_rad) - std::sin(angle1_rad)};
}

Eigen::Vector2d TurnBetween(int place1, int place2, int num_photos) {
  return TurnBetween(2 * kPi * place1 / num_photos, 2 * kPi * place2 / num_photos);
}

double OrbitingThing::Density(const MatchMove& move) const {
  const double variance = sigma_px * sigma_px;
  return std::exp(-0.5 * (move.px - image_from_turn * move.turn).squaredNorm() / variance) /
         (2 * kPi * variance);
}

bool OrbitingThing::Explains(const MatchMove& move) const {
  return share > 0 && (move.px - image_from_turn * move.turn).norm() < kSigmas * sigma_px;
}

OrbitingThing FindOrbitingThing(const std::vector<MatchMove>& far_moves, double extent) {
  OrbitingThing orbit;
  if (far_moves.size() < kOrbitUnknowns) return orbit;
  std::mt19937 random(0);
  std::uniform_int_distribution<size_t> any(0, far_moves.size() - 1);
  std::ptrdiff_t most = 0;
  for (int draw = 0; draw < kDraws; ++draw) {
    const MatchMove& a = far_moves[any(random)];
    const MatchMove& b = far_moves[any(random)];
    Eigen::Matrix2d turns;
    Eigen::Matrix2d moves;
    turns << a.turn, b.turn;
    moves << a.px, b.px;
    if (std::abs(turns.determinant()) < kLeastTurn) continue;
    const Eigen::Matrix2d map = moves * turns.inverse();
    const auto num = std::count_if(far_moves.begin(), far_moves.end(), [&](const MatchMove& move) {
      return (move.px - map * move.turn).squaredNorm() < kOrbitPx * kOrbitPx;
    });
    if (num <= most) continue;
    most = num;
    orbit.image_from_turn = map;
  }
  orbit.sigma_px = 0.5 * kOrbitPx;
  double share = static_cast<double>(most) / static_cast<double>(far_moves.size());
  const double even = EvenDensity(extent);
  double gain = 0;
  for (int round = 0; round < kRounds; ++round) {
    Eigen::Matrix2d products = Eigen::Matrix2d::Zero();
    Eigen::Matrix2d squares = Eigen::Matrix2d::Zero();
    double sum = 0;
    double sum_squares = 0;
    gain = 0;
    for (const MatchMove& move : far_moves) {
      const double orbiting = share * orbit.Density(move);
      const double density = orbiting + (1 - share) * even;
      const double weight = orbiting / density;
      products += weight * move.px * move.turn.transpose();
      squares += weight * move.turn * move.turn.transpose();
      sum += weight;
      sum_squares += weight * (move.px - orbit.image_from_turn * move.turn).squaredNorm();
      gain += std::log(density / even);
    }
    if (!(sum > kOrbitUnknowns) || !(squares.determinant() > kLeastTurn)) return {};
    orbit.image_from_turn = products * squares.inverse();
    orbit.sigma_px = std::clamp(std::sqrt(sum_squares / (2 * sum)), 1.0, kOrbitPx);
    share = sum / static_cast<double>(far_moves.size());
  }
  if (gain > 0.5 * kOrbitUnknowns * std::log(static_cast<double>(far_moves.size())) + kCertain) {
    orbit.share = share;
    orbit.gain = gain;
  }
  return orbit;
}

WrongMatches::WrongMatches(const std::vector<MatchMove>& far_moves, double extent) : extent_(extent) {
  const size_t stride = 1 + far_moves.size() / kMaxMoves;
  std::vector<MatchMove> chosen;
  for (size_t k = 0; k < far_moves.size(); k += stride) {
    chosen.push_back(far_moves[k]);
    moves_.push_back(far_moves[k].px);
    moves_.emplace_back(-far_moves[k].px);
  }
  orbit_ = FindOrbitingThing(chosen, extent);
}

double WrongMatches::Chance(const MatchMove& move) const {
  if (moves_.size() <= kNearestMoves) return 1 / extent_;
  std::vector<double> squared(moves_.size());
  for (size_t k = 0; k < moves_.size(); ++k) squared[k] = (move.px - moves_[k]).squaredNorm();
  const auto nearest = squared.begin() + static_cast<std::ptrdiff_t>(kNearestMoves);
  std::nth_element(squared.begin(), nearest, squared.end());
  const double area = kPi * std::max(*nearest, 1.0);
  double density = static_cast<double>(kNearestMoves) / (static_cast<double>(moves_.size()) * area);
  density += orbit_.share * (orbit_.Density(move) - density);
  return extent_ * (kEvenShare * EvenDensity(extent_) + (1 - kEvenShare) * density);
}

}  // namespace s2gs
