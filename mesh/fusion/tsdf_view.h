#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "mesh/fusion/depth_view.h"
#include "mesh/fusion/tsdf.h"

namespace s2gs {

/// A depth view made ready for fusion: a plane for each pixel of the part of the view that shows the object.
struct TsdfView {
  ObjectView camera;
  Eigen::Vector2d first_position = Eigen::Vector2d::Zero();
  int map_x = 0;  ///< the map's part of the view [px]
  int map_y = 0;
  int map_width = 0;
  int map_height = 0;
  std::vector<PixelPlane> planes;  ///< see TsdfViewParams.
  std::vector<uint32_t> colors;    ///< R | G << 8 | B << 16, as `planes` without the first two; or empty.
  int64_t num_depths = 0;          ///< pixels of positive weight.
  double median_depth = 0;         ///< of those.

  uint64_t Bytes() const { return planes.size() * sizeof(PixelPlane) + colors.size() * sizeof(uint32_t); }
  /// Ray with z = 1 through the centre of a map pixel.
  Eigen::Vector3d Ray(double column, double row) const {
    return {(map_x + column + first_position.x() - camera.cx) / camera.fx,
            (map_y + row + first_position.y() - camera.cy) / camera.fy, 1};
  }
};

/// Weights are cosines of the viewing angle, times the mask, over the square of the depth: a depth's error
/// grows with it. Throws UserError when sizes do not fit together or the camera cannot be used.
TsdfView PrepareTsdfView(const DepthView& view, const TsdfOptions& options);

TsdfViewParams ViewParams(const TsdfView& view, const Eigen::Vector3d& origin_in_object, double voxel_size);

/// Points of the view's surface for choosing the grid.
struct TsdfSurfaceSample {
  Eigen::Vector3d x_in_object;
  float depth = 0;
  float pixel = 0;  ///< edge of a pixel at the point's depth.
};
std::vector<TsdfSurfaceSample> SampleTsdfSurface(const TsdfView& view, int max_samples);

/// Keys of all blocks (TsdfBlockIndex) within the truncation of the view's surface along its rays and inside
/// of `region`; sorted, distinct. Stops early when there are more than `max_blocks`.
struct TsdfBlockRequest {
  Eigen::Vector3d origin;
  double voxel_size = 0;
  double truncation_voxels = 0;
  Eigen::AlignedBox3d region;
  size_t max_blocks = 0;
};
std::vector<uint64_t> FindViewBlocks(const TsdfView& view, const TsdfBlockRequest& request,
                                     int64_t* num_outliers);

/// Distance in pixels of each pixel to the nearest one that is set; large when none is.
/// Exact Euclidean (Felzenszwalb and Huttenlocher, "Distance transforms of sampled functions", 2012).
std::vector<float> DistanceToSet(const std::vector<uint8_t>& set, int width, int height);

}  // namespace s2gs
