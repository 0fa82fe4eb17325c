#include "sfm_split/scale/markers.h"

#include <algorithm>
#include <opencv2/aruco.hpp>
#include <opencv2/core.hpp>
#include <set>
#include <utility>

#include "sfm_split/base/error.h"
#include "sfm_split/scale/aruco_dictionary.h"

namespace s2gs {
namespace {

using Names = std::vector<std::pair<std::string, cv::aruco::PREDEFINED_DICTIONARY_NAME>>;

const Names& Known() {
  static const Names names = {{"4X4", cv::aruco::DICT_4X4_1000},
                              {"5X5", cv::aruco::DICT_5X5_1000},
                              {"6X6", cv::aruco::DICT_6X6_1000},
                              {"7X7", cv::aruco::DICT_7X7_1000},
                              {"ARUCO_ORIGINAL", cv::aruco::DICT_ARUCO_ORIGINAL},
                              {"APRILTAG_16H5", cv::aruco::DICT_APRILTAG_16h5},
                              {"APRILTAG_25H9", cv::aruco::DICT_APRILTAG_25h9},
                              {"APRILTAG_36H10", cv::aruco::DICT_APRILTAG_36h10},
                              {"APRILTAG_36H11", cv::aruco::DICT_APRILTAG_36h11}};
  return names;
}

}  // namespace

cv::Ptr<cv::aruco::Dictionary> ArucoDictionary(const std::string& name) {
  for (const auto& [known, number] : Known()) {
    if (known == name) return cv::aruco::getPredefinedDictionary(number);
  }
  std::string list;
  for (const auto& [known, number] : Known()) list += (list.empty() ? "" : ", ") + known;
  throw UserError("there is no dictionary of markers named \"" + name + "\", but " + list);
}

const std::vector<std::string>& MarkerDictionaries() {
  static const std::vector<std::string> names = [] {
    std::vector<std::string> list;
    list.reserve(Known().size());
    for (const auto& [name, number] : Known()) list.push_back(name);
    return list;
  }();
  return names;
}

std::vector<MarkerSighting> DetectMarkers(const std::vector<uint8_t>& grey, int width, int height,
                                          const std::string& dictionary) {
  S2GS_INVARIANT(grey.size() == static_cast<size_t>(width) * height);
  const cv::Mat picture(height, width, CV_8UC1, const_cast<uint8_t*>(grey.data()));
  const cv::Ptr<cv::aruco::DetectorParameters> parameters = cv::aruco::DetectorParameters::create();
  parameters->cornerRefinementMethod = cv::aruco::CORNER_REFINE_SUBPIX;
  std::vector<std::vector<cv::Point2f>> corners;
  std::vector<int> ids;
  cv::aruco::detectMarkers(picture, ArucoDictionary(dictionary), corners, ids, parameters);
  std::vector<MarkerSighting> sightings;
  std::set<int> seen;
  for (size_t i = 0; i < ids.size(); ++i) {
    if (!seen.insert(ids[i]).second) continue;
    MarkerSighting sighting;
    sighting.id = ids[i];
    // OpenCV counts from the centre of the first pixel.
    for (size_t k = 0; k < 4; ++k) sighting.corners[k] = {corners[i][k].x + 0.5, corners[i][k].y + 0.5};
    sightings.push_back(sighting);
  }
  std::sort(sightings.begin(), sightings.end(),
            [](const MarkerSighting& a, const MarkerSighting& b) { return a.id < b.id; });
  return sightings;
}

MarkerCells CellsOfMarker(const std::string& dictionary, int id) {
  const cv::Ptr<cv::aruco::Dictionary> codes = ArucoDictionary(dictionary);
  if (id < 0 || id >= codes->bytesList.rows) {
    throw UserError("the dictionary " + dictionary + " has the markers 0 to " +
                    std::to_string(codes->bytesList.rows - 1) + ", and no " + std::to_string(id));
  }
  MarkerCells cells;
  cells.side = codes->markerSize + 2;
  cv::Mat picture;
  codes->drawMarker(id, cells.side, picture, 1);
  for (int row = 0; row < cells.side; ++row) {
    for (int column = 0; column < cells.side; ++column) {
      cells.is_white.push_back(picture.at<uint8_t>(row, column) > 127 ? 1 : 0);
    }
  }
  return cells;
}

}  // namespace s2gs
