#pragma once

#include <Eigen/Core>
#include <vector>

namespace s2gs {

/// Where wrong matches of a camera that stands still fall. Not anywhere: highlights stay where the light is,
/// and what an object of revolution shows slides along it, so that a wrong geometry that moves nothing
/// explains them well. How they move is seen between the photos that are farthest apart, where few matches
/// are right: the density of their displacements, by the distance of the k-th nearest, beside even chance.
class WrongMatches {
 public:
  /// \param far_moves  displacements of matches between photos far apart [px], in either direction.
  /// \param extent     of the object [px]: a right match lies anywhere along its epipolar line.
  WrongMatches(const std::vector<Eigen::Vector2d>& far_moves, double extent);

  /// Density of a wrong match's epipolar error [1 / px], for a match that moved so.
  double Chance(const Eigen::Vector2d& move) const;

 private:
  std::vector<Eigen::Vector2d> moves_;
  double extent_ = 1;
  mutable std::vector<double> squared_;
};

/// The share of a station's matches, those of photos farthest apart, that wrong ones are told by.
constexpr double kFarShare = 0.25;

}  // namespace s2gs
