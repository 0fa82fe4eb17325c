#pragma once

#include <map>
#include <vector>

#include "sfm_split/scene/io/colmap_model.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

/// Camera pose by station: that of its first image in the background's model. Without one the largest
/// station's camera is the world's frame.
std::map<int, Rigid3> StationPoses(const ScanFeatures& features, const ColmapModel* background);

/// A photo from a station that the background knows.
struct PhotoOnTurn {
  size_t image = 0;  ///< index into the features' images.
  Rigid3 cam_from_world;
  double angle_rad = 0;  ///< of the table, about the axis.
};

/// The cameras of the scan, those of the background's model as it has them.
std::vector<Camera> CamerasBeside(const ScanFeatures& features, const ColmapModel* background);

/// An aligned scene, without points of the object, of photos that turn about one axis in the background's
/// world. \param background  null or empty: none. \param reference   of the photos: the one whose angle is 0.
AlignedScene SceneAboutAxis(const ScanFeatures& features, const ColmapModel* background,
                            const TurntableAxis& axis, const std::vector<PhotoOnTurn>& photos,
                            size_t reference, bool scale_observable);

}  // namespace s2gs
