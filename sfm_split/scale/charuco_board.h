#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "sfm_split/base/error.h"
#include "sfm_split/scale/located_marks.h"
#include "sfm_split/scale/scale_bars.h"

namespace s2gs {

/// A chessboard with markers in its white squares, as OpenCV prints them.
struct CharucoBoard {
  int columns = 0;         ///< squares across.
  int rows = 0;            ///< squares down.
  double square_mm = 0;    ///< side of the squares.
  double marker_mm = 0;    ///< side of the markers.
  std::string dictionary;  ///< of markers.h; the markers are numbered from 0.

  OptionCheck Check() const;
};

/// The board's inner corners in a grey picture, by their number, row by row from the top left [px, COLMAP's
/// convention], to a fraction of a pixel. Where two squares of each kind meet ink that spreads and edges that
/// blur move nothing. Garrido-Jurado et al. (2014) and OpenCV's aruco module.
std::map<int, Eigen::Vector2d> DetectBoardCorners(const std::vector<uint8_t>& grey, int width, int height,
                                                  const CharucoBoard& board);

/// One bar for each row and column of inner corners: between the two of its corners that were located and
/// are farthest apart. \param located  by the corners' numbers.
std::vector<ScaleBar> BarsOfBoard(const CharucoBoard& board, const std::map<int, LocatedMark>& located);

/// The board as it is printed, for tests and for those who have none: grey, rows from top to bottom.
std::vector<uint8_t> DrawBoard(const CharucoBoard& board, int pixels_per_square);

}  // namespace s2gs
