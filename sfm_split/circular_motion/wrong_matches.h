#pragma once

#include <Eigen/Core>
#include <vector>

namespace s2gs {

/// How a match moved between two photos of a station.
struct MatchMove {
  Eigen::Vector2d px = Eigen::Vector2d::Zero();
  /// From the first photo's place on the unit circle to the second's, at their angles of the table.
  Eigen::Vector2d turn = Eigen::Vector2d::Zero();
};

Eigen::Vector2d TurnBetween(double angle1_rad, double angle2_rad);
/// The same if the photos of the station closed a turn. \param place1, place2  in the station, of num_photos.
Eigen::Vector2d TurnBetween(int place1, int place2, int num_photos);

/// A thing of revolution that stands beside the table's axis goes around it and does not seem to turn: its
/// outline, its highlights and what texture repeats along it all move alike, px = image_from_turn * turn.
struct OrbitingThing {
  double share = 0;  ///< of the moves that follow it; 0: there is none.
  double gain = 0;   ///< logarithm of how much likelier the moves are than if they lay anywhere; 0: none.
  Eigen::Matrix2d image_from_turn = Eigen::Matrix2d::Zero();  ///< [px]
  double sigma_px = 1;                                        ///< of its moves, along each axis.

  /// Density of a move that follows it [1 / px^2].
  double Density(const MatchMove& move) const;
  /// Whether it moves as the thing does, to three standard deviations; never where there is none.
  bool Explains(const MatchMove& move) const;
};

/// By consensus, then as a mixture with moves that lie anywhere. \param extent  of the object [px].
OrbitingThing FindOrbitingThing(const std::vector<MatchMove>& far_moves, double extent);

/// Where wrong matches of a camera that stands still fall. Not anywhere: highlights stay where the light is,
/// and what an object of revolution shows slides along it or goes with it, so that a wrong geometry that
/// turns nothing explains them well. How they move is seen between the photos that are farthest apart, where
/// few matches are right: as a thing that orbits, and as the density of displacements, by the distance of the
/// k-th nearest, beside even chance.
class WrongMatches {
 public:
  /// \param far_moves  of matches between photos far apart, in either direction.
  /// \param extent     of the object [px]: a right match lies anywhere along its epipolar line.
  WrongMatches(const std::vector<MatchMove>& far_moves, double extent);

  /// Density of a wrong match's epipolar error [1 / px], for a match that moved so. From several threads.
  double Chance(const MatchMove& move) const;

  const OrbitingThing& orbit() const { return orbit_; }
  /// OrbitingThing::gain.
  double OrbitGain() const { return orbit_.gain; }

 private:
  OrbitingThing orbit_;
  std::vector<Eigen::Vector2d> moves_;
  double extent_ = 1;
};

/// The share of wrong matches that fall anywhere: a judgement.
inline constexpr double kEvenShare = 0.2;

/// The share of a station's matches, those of photos farthest apart, that wrong ones are told by.
constexpr double kFarShare = 0.25;

}  // namespace s2gs
