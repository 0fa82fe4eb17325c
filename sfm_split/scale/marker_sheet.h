#pragma once

#include <Eigen/Core>
#include <ostream>
#include <string>
#include <vector>

#include "sfm_split/base/error.h"

namespace s2gs {

struct MarkerSheetOptions {
  double diameter_mm = 280;     ///< of the round sheet.
  double marker_size_mm = 25;   ///< side of the markers' black squares.
  double hole_diameter_mm = 0;  ///< in the middle, where the object stands: nothing is printed there.
  std::string marker_dictionary = "4X4";  ///< of markers.h.
  int first_id = 0;                       ///< of the markers, which are numbered on.
  double speckle_size_mm = 4;             ///< diameter of the largest speckles; 0: none.

  OptionCheck Check() const;
};

/// A sheet for the table: markers along its rim, one corner row towards the middle, and speckle between them
/// that gives photos something to match where the object has little texture.
struct MarkerSheet {
  struct Marker {
    int id = 0;
    Eigen::Vector2d center;  ///< from the sheet's middle, x right, y down [mm].
    double angle = 0;        ///< of its first side against x, clockwise [rad].
  };
  struct Speckle {
    Eigen::Vector2d center;  ///< [mm]
    double radius = 0;       ///< [mm]
    int grey = 0;            ///< 0 to 255.
  };
  std::vector<Marker> markers;
  std::vector<Speckle> speckles;
};

/// The same sheet for the same options and seed. Throws UserError where no three markers fit on the rim, or
/// the dictionary has too few.
MarkerSheet MakeMarkerSheet(const MarkerSheetOptions& options, uint64_t seed);

/// As a picture to print at its true size: SVG in millimetres.
void WriteMarkerSheet(std::ostream& stream, const MarkerSheet& sheet, const MarkerSheetOptions& options);

}  // namespace s2gs
