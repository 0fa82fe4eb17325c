#include "sfm_split/scale/charuco_board.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/aruco.hpp>
#include <opencv2/aruco/charuco.hpp>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "sfm_split/base/number_text.h"
#include "sfm_split/scale/aruco_dictionary.h"

namespace s2gs {
namespace {

// Half the side of the window that a corner's edges are looked at in [px].
constexpr int kMinWindow = 2;
constexpr int kMaxWindow = 10;

cv::Ptr<cv::aruco::CharucoBoard> BoardOf(const CharucoBoard& board) {
  return cv::aruco::CharucoBoard::create(board.columns, board.rows, static_cast<float>(board.square_mm),
                                         static_cast<float>(board.marker_mm),
                                         ArucoDictionary(board.dictionary));
}

// Moves each corner to where the edges around it meet, within a window that no marker reaches into: OpenCV's
// own takes them in, which moves corners by half a pixel.
void Refine(const cv::Mat& picture, const CharucoBoard& board, const std::vector<int>& ids,
            std::vector<cv::Point2f>* corners) {
  std::map<int, cv::Point2f> by_id;
  for (size_t i = 0; i < ids.size(); ++i) by_id[ids[i]] = (*corners)[i];
  const double gap = (1 - board.marker_mm / board.square_mm) / 2;  // from a corner to a marker, in squares
  const int columns = board.columns - 1;
  for (size_t i = 0; i < ids.size(); ++i) {
    double square_px = std::numeric_limits<double>::infinity();
    for (const int step : {-1, 1, -columns, columns}) {
      const auto other = by_id.find(ids[i] + step);
      // Of the next row's other end the distance is larger than that of a neighbour.
      if (other != by_id.end()) square_px = std::min(square_px, cv::norm(other->second - by_id[ids[i]]));
    }
    if (!std::isfinite(square_px)) continue;
    const int window = std::clamp(static_cast<int>(gap * square_px), kMinWindow, kMaxWindow);
    std::vector<cv::Point2f> one = {by_id[ids[i]]};
    cv::cornerSubPix(picture, one, {window, window}, {-1, -1},
                     {cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 50, 1e-3});
    if (cv::norm(one[0] - by_id[ids[i]]) <= window) (*corners)[i] = one[0];
  }
}

}  // namespace

OptionCheck CharucoBoard::Check() const {
  for (const auto& [name, value] : {std::pair("charuco_columns", columns), std::pair("charuco_rows", rows)}) {
    if (value < 3 || value > 100) {
      return OptionFault{name, std::to_string(value), "3 <= " + std::string(name) + " <= 100"};
    }
  }
  if (!(square_mm > 0 && square_mm <= 1e5)) {
    return OptionFault{"charuco_square_mm", NumberText(square_mm), "0 < charuco_square_mm <= 100000"};
  }
  if (!(marker_mm > 0 && marker_mm < square_mm)) {
    return OptionFault{"marker_size_mm", NumberText(marker_mm), "0 < marker_size_mm < charuco_square_mm"};
  }
  return std::nullopt;
}

std::map<int, Eigen::Vector2d> DetectBoardCorners(const std::vector<uint8_t>& grey, int width, int height,
                                                  const CharucoBoard& board) {
  S2GS_INVARIANT(grey.size() == static_cast<size_t>(width) * height && !board.Check());
  const cv::Mat picture(height, width, CV_8UC1, const_cast<uint8_t*>(grey.data()));
  const cv::Ptr<cv::aruco::CharucoBoard> charuco = BoardOf(board);
  std::vector<std::vector<cv::Point2f>> markers;
  std::vector<int> marker_ids;
  cv::aruco::detectMarkers(picture, charuco->dictionary, markers, marker_ids);
  std::map<int, Eigen::Vector2d> corners;
  if (marker_ids.empty()) return corners;
  std::vector<cv::Point2f> found;
  std::vector<int> ids;
  cv::aruco::interpolateCornersCharuco(markers, marker_ids, picture, charuco, found, ids);
  Refine(picture, board, ids, &found);
  // OpenCV counts from the centre of the first pixel.
  for (size_t i = 0; i < ids.size(); ++i) corners[ids[i]] = {found[i].x + 0.5, found[i].y + 0.5};
  return corners;
}

std::vector<ScaleBar> BarsOfBoard(const CharucoBoard& board, const std::map<int, LocatedMark>& located) {
  const int columns = board.columns - 1;
  const int rows = board.rows - 1;
  std::vector<ScaleBar> bars;
  const auto add = [&](const std::string& name, int count, int first, int step) {
    int begin = -1;
    int end = -1;
    for (int i = 0; i < count; ++i) {
      if (located.count(first + i * step) == 0) continue;
      if (begin < 0) begin = i;
      end = i;
    }
    if (end <= begin) return;
    const double measured = (located.at(first + begin * step).x - located.at(first + end * step).x).norm();
    if (!(measured > 0)) return;
    bars.push_back({name, 1e-3 * board.square_mm * (end - begin), measured, 0});
  };
  for (int row = 0; row < rows; ++row) add("board row " + std::to_string(row + 1), columns, row * columns, 1);
  for (int column = 0; column < columns; ++column) {
    add("board column " + std::to_string(column + 1), rows, column, columns);
  }
  return bars;
}

std::vector<uint8_t> DrawBoard(const CharucoBoard& board, int pixels_per_square) {
  S2GS_INVARIANT(!board.Check());
  cv::Mat picture;
  BoardOf(board)->draw({board.columns * pixels_per_square, board.rows * pixels_per_square}, picture, 0, 1);
  return {picture.begin<uint8_t>(), picture.end<uint8_t>()};
}

}  // namespace s2gs
