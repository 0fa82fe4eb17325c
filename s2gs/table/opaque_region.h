#pragma once

#include <Eigen/Core>
#include <optional>

#include "s2gs/backend/backend.h"
#include "s2gs/core/pinhole_view.h"
#include "s2gs/core/rotating_region.h"
#include "s2gs/image/image_error.h"

namespace s2gs {

constexpr float kOpaque = 0.5F;  ///< of a pixel that shows a surface, as in depth maps.

/// Where a pixel's ray enters a region, in the camera's frame.
struct RegionHit {
  double depth = 0;        ///< along the camera's axis.
  Eigen::Vector3d normal;  ///< of the region's surface, outwards.
};

/// A region as a camera would see it if nothing stood before it.
class RegionView {
 public:
  RegionView(const RotatingRegion& region, const PinholeView& view);

  /// Nothing where the pixel does not show it. From within, the hit is at the near plane and faces the
  /// camera.
  std::optional<RegionHit> At(int x, int y) const;

 private:
  PinholeView view_;
  Eigen::Matrix3d world_from_cam_;
  Eigen::Vector3d up_;
  Eigen::Vector3d from_level_;  // of the camera, from the axis
  double low_;                  // above the camera
  double high_;
  double radius_;
};

/// Adds the pixels that show the region, as if nothing stood before it.
void AddRegion(const RotatingRegion& region, const PinholeView& view, PixelMask* mask);

/// Draws the region as an opaque body into the depths, normals and opacity of what was rendered from a view:
/// where it shows nothing, or something behind the region's surface.
void DrawOpaqueRegion(const RotatingRegion& region, const PinholeView& view, RenderedView* rendered);

/// Pixels of a photo, marked by 255.
struct MarkedPixels {
  Image8 marks;      ///< one channel.
  PinholeView view;  ///< of the marks' size.
};

/// The same where a photo shows the region, whatever else was rendered there.
void DrawRegionWhereSeen(const RotatingRegion& region, const MarkedPixels& seen, const PinholeView& view,
                         RenderedView* rendered);

}  // namespace s2gs
