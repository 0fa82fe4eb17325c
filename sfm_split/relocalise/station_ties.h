#pragma once

#include <vector>

#include "sfm_split/turntable/table_angle.h"

namespace s2gs {

// When the object has placed the cameras of every station against itself, one unknown is left of each
// station in the world: its angle about the table's axis. Matches on the background between the photos of two
// stations tell it, without any triangulated point.

/// Matches on the static background between two stations, 0 <= station < other_station; `cam_from_world` is
/// the first one's and `other_cam_from_object` the second one's camera-from-world.
struct StationMatches {
  int station = 0;
  int other_station = 0;
  std::vector<MatchAcrossTurn> matches;
  /// False: nearest neighbours of which most may be wrong. They are asked only where verified ones do not tie
  /// a station, and believed only beyond what chance and any other angle explain.
  bool are_verified = true;
};

struct TieOptions {
  double max_error_px = 4;  ///< Sampson's error.
  int min_inliers = 8;      ///< matches that must agree.
  double min_share = 0.25;  ///< their share of all.
  double min_margin = 1.5;  ///< support over that of the best other angle.
  int max_matches = 400;    ///< verified ones of a pair of stations; more are thinned out.
};

/// How a station is tied to the others.
struct StationTie {
  /// Stations with the same number stand right against each other; it is the number of the station that the
  /// others were tied to. A station that could not be tied has its own.
  int component = 0;
  double turn_rad = 0;  ///< about the axis: new cam_from_world = cam_from_world * turn.
  int inliers = 0;      ///< of the matches with the stations tied before it.
  int matches = 0;
  double margin = 0;
  bool by_raw_matches = false;
};

/// Ties stations to each other, those with the most support first, starting from `root`. A station that
/// matches support where it stands nearly as well as anywhere else is not turned.
std::vector<StationTie> TieStations(int num_stations, int root, const TurntableAxis& axis,
                                    const std::vector<StationMatches>& pairs, const TieOptions& options);

}  // namespace s2gs
