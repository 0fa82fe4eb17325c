#pragma once

#include <string>
#include <vector>

#include "sfm_split/scene/io/turntable_file.h"

namespace s2gs {

/// How the table turned while one station took its photos, in the order of their names.
struct StationSteps {
  int station = 0;
  std::vector<std::string> photos;
  double step_deg = 0;         ///< median turn from photo to photo, signed; NaN with one photo [degrees].
  double spread_deg = 0;       ///< standard deviation of the deviations, robust; NaN with fewer than 3.
  double largest_gap_deg = 0;  ///< widest arc between photos, going round [degrees].
  /// From equal steps through all photos, their median taken off; photos that are missing between two count
  /// as steps. Empty when the table did not turn by half a degree from photo to photo.
  std::vector<double> deviations_deg;
};

/// By station.
std::vector<StationSteps> FindSteps(const TurntableFile& turntable);

}  // namespace s2gs
