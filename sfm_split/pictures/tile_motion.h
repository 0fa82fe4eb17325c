#pragma once

#include <Eigen/Core>
#include <vector>

namespace s2gs {

// How a camera that may have been touched moved between two pictures, from what their tiles do.

/// Of a tile that agrees with the camera's motion; what a tripod moved by 1/200 of its distance shows is
/// over 1. [px of the picture]
constexpr double kMaxResidualPx = 0.35;

/// What one tile of a picture does from there to another picture of the scene.
struct TileMatch {
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();  ///< [px of the picture, from its corner]
  /// In both directions, so that noise moves it by no more than .1 px and its place across an edge leaks less
  /// than kMaxResidualPx into that along it; and not alike a few pixels beside, as a checked cloth is.
  bool is_textured = false;
  bool is_found = false;         ///< its gradients correlate better than those of unrelated tiles do.
  bool agrees = false;           ///< and it lies where the camera's own motion puts it.
  double correlation = 0;        ///< of the gradients, 1: equal but for contrast.
  double sigma_px = 0;           ///< standard deviation of the displacement.
  Eigen::Vector2d displacement;  ///< [px of the picture]
  /// Textured across one direction alone, or far more than along it, as the rim of a plain disc is and the
  /// foot of a wall: it says nothing of a move along the edge, and is not counted as found. Such tiles are
  /// asked where the others do not show that the camera stood still.
  bool is_edge = false;
  Eigen::Vector2d normal = Eigen::Vector2d::Zero();  ///< of an edge; `displacement` lies along it.
};

/// How far a motion takes a tile's centre [px].
Eigen::Vector2d Moved(const Eigen::Matrix3d& H, const TileMatch& tile);

/// The directions along which a tile tells its place, as a projection: all, an edge's is its normal.
Eigen::Matrix2d Told(const TileMatch& tile);

/// What a motion leaves of a tile's displacement along those [px].
Eigen::Vector2d Residual(const Eigen::Matrix3d& H, const TileMatch& tile);

/// Of an agreeing tile's residual [px].
double Bound(const TileMatch& tile);

/// Whether a tile or an edge was found again.
bool IsSeen(const TileMatch& tile);

/// The simplest motion that explains the tiles without edges, each model started from where the simpler one
/// ended: none, a shift, a roll beside it, growth beside both, an affine map or a homography. \param width,
/// height  of the picture [px].
Eigen::Matrix3d FitTileMotion(const std::vector<TileMatch>& tiles, int width, int height);

/// A camera's turn and how many numbers were chosen for it.
struct CameraTurn {
  Eigen::Matrix3d second_from_first;  ///< the motion that it was sought beyond, included.
  int num_parameters = 0;             ///< 0: nothing beyond that; 2: a shift; 3: a roll, too; 4: and growth.
};

/// What a camera that was turned a little about its centre shows, as tiles and edges ask for it beyond a
/// motion, by the criterion that chooses between motions: nothing, a shift of up to `radius`, a shift and
/// a roll about the picture's middle, or these and the growth of all that a lens shows when it focuses anew.
/// \param width, height  of the picture [px].
CameraTurn FitCameraTurn(const std::vector<TileMatch>& tiles, const Eigen::Matrix3d& from, int radius,
                         int width, int height);

}  // namespace s2gs
