#include "sfm_split/scale/located_marks.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "sfm_split/adjust/track_triangulation.h"
#include "sfm_split/scene/features.h"

namespace s2gs {
namespace {

// Sub-pixel corners of a marker that moved with its body are good to a few tenths of a pixel; in a photo of
// four thousand columns, blurred or at a slant, to several.
constexpr double kMaxErrorShare = 1.0 / 400;  // of the photo's longer side
constexpr double kLeastMaxErrorPx = 2;        // a judgement: where photos are small

// Ink spreads: an edge of what is printed is where it should be to a dot of 600 to the inch. All markers of
// a sheet are alike in that, on both sides.
constexpr double kPrintedEdgeM = 25.4e-3 / 600;

}  // namespace

std::map<int, LocatedMark> LocateMarks(const ColmapModel& model, const MarkSightings& sightings) {
  std::vector<PosedImage> images;
  std::vector<Keypoints> keypoints;
  std::vector<std::vector<int>> marks;               // of each keypoint
  std::vector<std::map<int, uint32_t>> keypoint_of;  // of each mark
  double longest = 0;
  for (const auto& [id, image] : model.images) {
    const auto found = sightings.find(image.name);
    if (found == sightings.end()) continue;
    const Camera& camera = model.cameras.at(image.camera_id);
    longest = std::max({longest, static_cast<double>(camera.width), static_cast<double>(camera.height)});
    images.push_back({true, &camera, image.cam_from_world});
    keypoints.emplace_back();
    marks.emplace_back();
    keypoint_of.emplace_back();
    for (const auto& [mark, xy] : found->second) {
      keypoint_of.back()[mark] = static_cast<uint32_t>(keypoints.back().size());
      keypoints.back().push_back(xy.cast<float>());
      marks.back().push_back(mark);
    }
  }
  std::vector<ImagePairMatches> pairs;
  for (size_t i = 0; i < images.size(); ++i) {
    for (size_t j = i + 1; j < images.size(); ++j) {
      ImagePairMatches pair{static_cast<int>(i), static_cast<int>(j), {}};
      for (const auto& [mark, keypoint] : keypoint_of[i]) {
        const auto other = keypoint_of[j].find(mark);
        if (other != keypoint_of[j].end()) pair.matches.push_back({keypoint, other->second});
      }
      if (!pair.matches.empty()) pairs.push_back(std::move(pair));
    }
  }
  TrackOptions options;
  options.max_error_px = std::max(kLeastMaxErrorPx, kMaxErrorShare * longest);
  std::map<int, LocatedMark> located;
  for (const TrackPoint& point : TriangulateTracks(images, keypoints, pairs, options)) {
    const int mark = marks[point.track[0].image][point.track[0].keypoint];
    LocatedMark& best = located[mark];
    if (static_cast<int>(point.track.size()) <= best.num_photos) continue;
    best = {point.x_in_body, static_cast<int>(point.track.size()), point.mean_error_px};
  }
  return located;
}

std::vector<LocatedMarker> LocateMarkers(
    const ColmapModel& model, const std::map<std::string, std::vector<MarkerSighting>>& sightings) {
  MarkSightings marks;
  for (const auto& [name, seen] : sightings) {
    for (const MarkerSighting& marker : seen) {
      for (int k = 0; k < 4; ++k) marks[name][4 * marker.id + k] = marker.corners[k];
    }
  }
  const std::map<int, LocatedMark> located = LocateMarks(model, marks);
  std::vector<LocatedMarker> markers;
  for (auto first = located.begin(); first != located.end(); ++first) {
    if (first->first % 4 != 0) continue;
    LocatedMarker marker;
    marker.id = first->first / 4;
    bool is_whole = true;
    for (int k = 0; k < 4; ++k) {
      const auto corner = located.find(first->first + k);
      if (corner == located.end()) {
        is_whole = false;
        break;
      }
      marker.corners[k] = corner->second;
    }
    if (!is_whole) continue;
    const auto distance = [&](int a, int b) { return (marker.corners[a].x - marker.corners[b].x).norm(); };
    marker.num_photos = marker.corners[0].num_photos;
    for (int k = 0; k < 4; ++k) {
      marker.side += distance(k, (k + 1) % 4) / 4;
      marker.num_photos = std::min(marker.num_photos, marker.corners[k].num_photos);
    }
    if (!(marker.side > 0)) continue;
    for (int k = 0; k < 4; ++k) {
      marker.bend = std::max(marker.bend, std::abs(distance(k, (k + 1) % 4) / marker.side - 1));
    }
    for (int k = 0; k < 2; ++k) {
      marker.bend = std::max(marker.bend, std::abs(distance(k, k + 2) / (std::sqrt(2.0) * marker.side) - 1));
    }
    markers.push_back(marker);
  }
  return markers;
}

std::vector<ScaleBar> BarsOfMarkers(const std::vector<LocatedMarker>& markers, double side_m) {
  std::vector<ScaleBar> bars;
  bars.reserve(markers.size());
  for (const LocatedMarker& marker : markers) {
    // The mean of four sides, each as much off as the worst of them or less.
    bars.push_back({"marker " + std::to_string(marker.id), side_m, marker.side, marker.bend * marker.side / 2,
                    2 * kPrintedEdgeM / side_m});
  }
  return bars;
}

}  // namespace s2gs
