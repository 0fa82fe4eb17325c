#pragma once

#include <Eigen/Core>
#include <memory>
#include <utility>
#include <vector>

#include "mesh/surface/object_view.h"
#include "s2gs/image/image_file.h"

namespace s2gs {

/// A depth map with its camera and what else is known of the same view. Colours and mask may be larger or
/// smaller than the depth map: all show the same part of the image plane.
struct DepthView {
  ObjectView camera;  ///< of the depth map's size.
  /// Image position of the value in column 0, row 0: its pixel's centre. For the maps in a COLMAP workspace
  /// it is kColmapMapPosition.
  Eigen::Vector2d first_position = {0.5, 0.5};
  /// height * width depths along the camera's z axis, in the poses' unit. Unknown: 0, negative, not finite.
  std::vector<float> depths;
  /// 3 * height * width, planar: unit normals in the camera's frame. Empty, or zero or not finite where
  /// unknown: taken from the depths.
  std::vector<float> normals;
  Image8 colors;  ///< RGB, or without pixels.
  /// One channel, or without pixels: how surely each pixel shows the object, 0 to 255. Outside of it depths
  /// do not count, and space is known to be empty.
  Image8 mask;
};

/// sfm_split/scene/io/colmap_maps.h says why.
inline const Eigen::Vector2d kColmapMapPosition = {0, 0};

/// Depth views that need not all be in memory at once.
class DepthViewSource {
 public:
  DepthViewSource() = default;
  DepthViewSource(const DepthViewSource&) = delete;
  DepthViewSource& operator=(const DepthViewSource&) = delete;
  virtual ~DepthViewSource() = default;

  virtual int size() const = 0;
  /// Gives the same view for the same index every time. Called from several threads at once, perhaps more
  /// than once for each view. May throw.
  virtual std::shared_ptr<const DepthView> Load(int index) const = 0;
};

/// Depth views in memory. It must outlive what Load returns.
class DepthViewList : public DepthViewSource {
 public:
  explicit DepthViewList(std::vector<DepthView> views) : views_(std::move(views)) {}
  int size() const override { return static_cast<int>(views_.size()); }
  std::shared_ptr<const DepthView> Load(int index) const override {
    return {std::shared_ptr<const DepthView>(), &views_[index]};  // not owned
  }

 private:
  std::vector<DepthView> views_;
};

}  // namespace s2gs
