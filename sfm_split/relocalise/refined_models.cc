#include <numeric>
#include <utility>

#include "sfm_split/relocalise/scan_refiner.h"

namespace s2gs {

ColmapModel ScanRefiner::BuildModel(const std::vector<TrackPoint>& points, const std::vector<size_t>& chosen,
                                    bool of_object) const {
  ColmapModel model;
  for (const View& view : aligned_->scene.views) {
    const auto i = static_cast<size_t>(image_of_name_.at(view.name));
    const ScanImage& features = features_.images[i];
    model.cameras[view.camera_id] = CameraOf(static_cast<int>(i));
    ColmapImage& image = model.images[features.image_id];
    image.image_id = features.image_id;
    image.name = features.name;
    image.camera_id = view.camera_id;
    image.cam_from_world = of_object ? view.CamFromObject() : view.cam_from_world;
    image.points2D.resize(features.keypoints.size());
    for (size_t k = 0; k < features.keypoints.size(); ++k) {
      image.points2D[k].xy = features.keypoints[k].cast<double>();
    }
  }
  uint64_t next_id = 1;
  for (const size_t p : chosen) {
    ColmapPoint3D point;
    point.point3D_id = next_id;
    point.xyz = points[p].x_in_body;
    point.error = points[p].mean_error_px;
    for (const TrackElement& element : WholeTrack(points[p], of_object)) {
      if (view_of_image_[static_cast<size_t>(element.image)] < 0) continue;
      const uint32_t image_id = features_.images[static_cast<size_t>(element.image)].image_id;
      ColmapPoint2D& point2D = model.images.at(image_id).points2D[element.keypoint];
      if (point2D.point3D_id != kInvalidPoint3DId) continue;
      point2D.point3D_id = next_id;
      point.track.push_back({image_id, element.keypoint});
    }
    if (point.track.size() < 2) {
      for (const ColmapTrackElement& element : point.track) {
        model.images.at(element.image_id).points2D[element.point2D_idx].point3D_id = kInvalidPoint3DId;
      }
      continue;
    }
    model.points3D[next_id++] = std::move(point);
  }
  return model;
}

void ScanRefiner::WriteModels() {
  std::vector<size_t> all(object_points_.size());
  std::iota(all.begin(), all.end(), size_t{0});
  aligned_->object = BuildModel(object_points_, all, true);
  if (!has_background_) {
    aligned_->background = ColmapModel();
    return;
  }
  all.resize(background_points_.size());
  std::iota(all.begin(), all.end(), size_t{0});
  aligned_->background = BuildModel(background_points_, all, false);
}

// A keypoint that sees a point of one body is that body's; a rotating one none of whose matches agrees with
// the adjusted poses is unknown again.
void ScanRefiner::Relabel(double max_error_px) {
  std::vector<std::vector<KeypointLabel>> labels;
  labels.reserve(features_.images.size());
  std::vector<std::vector<bool>> agrees;
  for (const ScanImage& image : features_.images) {
    labels.push_back(image.labels);
    labels.back().resize(image.keypoints.size(), KeypointLabel::kUnknown);
    agrees.emplace_back(image.keypoints.size(), false);
  }
  // Matches on their epipolar lines.
  const std::vector<std::vector<double>> errors = ErrorsOf(object_pairs_);
  for (size_t p = 0; p < errors.size(); ++p) {
    const ImagePairMatches& pair = object_pairs_[p];
    for (size_t m = 0; m < errors[p].size(); ++m) {
      if (errors[p][m] > max_error_px) continue;
      agrees[static_cast<size_t>(pair.image1)][pair.matches[m].point2D_idx1] = true;
      agrees[static_cast<size_t>(pair.image2)][pair.matches[m].point2D_idx2] = true;
    }
  }
  for (size_t i = 0; i < labels.size(); ++i) {
    if (view_of_image_[i] < 0) continue;
    for (size_t k = 0; k < labels[i].size(); ++k) {
      if (labels[i][k] == KeypointLabel::kRotating && !agrees[i][k]) labels[i][k] = KeypointLabel::kUnknown;
    }
  }
  for (const TrackPoint& point : background_points_) {
    for (const TrackElement& element : WholeTrack(point, false)) {
      labels[static_cast<size_t>(element.image)][element.keypoint] = KeypointLabel::kStatic;
    }
  }
  for (const TrackPoint& point : object_points_) {
    for (const TrackElement& element : point.track) {
      KeypointLabel& label = labels[static_cast<size_t>(element.image)][element.keypoint];
      if (label != KeypointLabel::kStatic) label = KeypointLabel::kRotating;
    }
  }
  for (size_t i = 0; i < labels.size(); ++i) {
    for (size_t k = 0; k < labels[i].size(); ++k) {
      const KeypointLabel before =
          k < features_.images[i].labels.size() ? features_.images[i].labels[k] : KeypointLabel::kUnknown;
      report_.relabelled_keypoints += labels[i][k] != before ? 1 : 0;
    }
  }
  report_.labels = std::move(labels);
}

}  // namespace s2gs
