#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <string>
#include <vector>

namespace s2gs {

/// A printed square marker as one photo shows it.
struct MarkerSighting {
  int id = 0;  ///< in its dictionary.
  /// In the marker's own order, clockwise from its top left [px, COLMAP's convention].
  std::array<Eigen::Vector2d, 4> corners;
};

/// The dictionaries of ArUco and AprilTag that are known, the largest of each family: "4X4", "5X5", "6X6",
/// "7X7", "ARUCO_ORIGINAL", "APRILTAG_16H5", "APRILTAG_25H9", "APRILTAG_36H10", "APRILTAG_36H11".
const std::vector<std::string>& MarkerDictionaries();

/// The markers in a grey picture, rows from top to bottom; corners to a fraction of a pixel. Of markers that
/// a picture shows twice only the first counts. Garrido-Jurado et al., "Automatic generation and detection of
/// highly reliable fiducial markers under occlusion" (2014), in OpenCV's aruco module.
/// \param dictionary  one of MarkerDictionaries().
std::vector<MarkerSighting> DetectMarkers(const std::vector<uint8_t>& grey, int width, int height,
                                          const std::string& dictionary);

/// A marker's black and white cells, its border included, row by row: 1 is white.
struct MarkerCells {
  int side = 0;  ///< cells along a side.
  std::vector<uint8_t> is_white;
};
/// Throws UserError for a number that the dictionary does not have.
MarkerCells CellsOfMarker(const std::string& dictionary, int id);

}  // namespace s2gs
