#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "plugin/cli/options.h"
#include "sfm_split/base/error.h"

namespace s2gs {

/// The lengths that make a scene metric, as the command line states them.
struct ScaleOptions {
  double marker_size_mm = 0;               ///< side of the markers' black squares; 0: no markers.
  std::string marker_dictionary = "auto";  ///< auto: the one of which most are seen.
  std::vector<int32_t> marker_ids;         ///< empty: all that are found.
  double known_length_mm = 0;              ///< between two points of the rotating part; 0: none.
  std::vector<std::string> point_a;        ///< NAME:X:Y [px]
  std::vector<std::string> point_b;
  double disc_diameter_mm = 0;        ///< 0: not known.
  std::vector<std::string> disc_rim;  ///< NAME:X:Y [px]
  int32_t charuco_columns = 0;        ///< 0: no board.
  int32_t charuco_rows = 0;
  double charuco_square_mm = 0;

  bool HasBoard() const { return charuco_columns > 0 || charuco_rows > 0 || charuco_square_mm > 0; }
  bool HasAny() const {
    return marker_size_mm > 0 || known_length_mm > 0 || disc_diameter_mm > 0 || HasBoard();
  }
  OptionCheck Check() const;
};

/// A place in a photo, as NAME:X:Y states it.
struct PhotoPlace {
  std::string name;
  double x = 0;  ///< [px, COLMAP's convention]
  double y = 0;
};

/// \param option  whose values the texts are. Throws CommandLineError where one is no NAME:X:Y.
std::vector<PhotoPlace> ParsePhotoPlaces(const std::vector<std::string>& texts, const std::string& option);

/// Adds all of them to a command.
void AddScaleOptions(Options* options, ScaleOptions* scale);

/// What belongs together is there together, and places are places; throws CommandLineError otherwise.
void RequireComplete(const ScaleOptions& scale);

/// Those that are stated, as arguments of model_scaler.
std::vector<std::string> ScaleArguments(const ScaleOptions& scale);

}  // namespace s2gs
