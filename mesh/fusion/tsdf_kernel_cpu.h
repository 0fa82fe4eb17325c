#pragma once

#include <cstdint>

#include "mesh/fusion/tsdf_voxel.h"

namespace s2gs {

constexpr int kPointGroup = 64;

/// One row of a depth map: padded by two values on each side, and two rows before and after it.
struct TsdfRowJob {
  const float* inverse_depths[5];  ///< row y - 2 to y + 2, at column 0; 0 where there is no depth.
  int count = 0;                   ///< columns.
  float fx = 0, fy = 0;            ///< [px]
  float first_ray_x = 0;           ///< x of column 0's ray with z = 1.
  float ray_y = 0;
  float min_cosine = 0;
  PixelPlane* planes = nullptr;  ///< untouched where there is no depth; weight: cosine / depth^2, or 0.
};

/// The fusion's inner loops, for one instruction set. All give the same bits.
struct TsdfCpuKernel {
  /// Adds one view to one block, whose first voxel is at `first_voxel` in the camera's frame.
  void (*add_to_block)(const TsdfViewParams& view, const TsdfVoxelParams& params, const float* first_voxel,
                       float* sums, float* weights);
  /// What the view says of kPointGroup points of the camera's frame, and where its planes have them.
  void (*sample_points)(const TsdfViewParams& view, const TsdfVoxelParams& params, const float* x,
                        const float* y, const float* z, int32_t* index, float* distance, float* weight);
  /// Planes from depths alone.
  void (*planes_of_row)(const TsdfRowJob& job);
};

/// The fastest that this processor can run.
const TsdfCpuKernel& BestTsdfCpuKernel();

}  // namespace s2gs
