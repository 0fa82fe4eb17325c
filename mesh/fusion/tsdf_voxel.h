#pragma once

#include <cmath>
#include <cstdint>

#include "s2gs/core/host_device.h"

namespace s2gs {

/// The surface that one pixel sees: the plane (a, b, c) . x = 1 through it, x in the camera's frame.
/// For a plane with unit normal n at n . x = e these are n / e. 1 / z is then an affine function of the
/// image, so the plane also gives the depth between pixel centres.
struct alignas(16) PixelPlane {
  float a = 0;
  float b = 0;
  float c = 0;
  /// Positive: how much the pixel counts. 0: nothing is known. Negative: the pixel shows no object, and the
  /// nearest one that does is this many pixels away.
  float weight = 0;
};

/// What the voxel update needs of a view. The map is the part of the view that shows the object; its first
/// two entries stand for all pixels outside of the image and for those of the image outside of the map.
struct TsdfViewParams {
  double rotation[9];     ///< row-major: camera from object, times the voxel size.
  double translation[3];  ///< of the grid's voxel (0, 0, 0) in the camera's frame.
  float fx, fy;           ///< [px]
  float focal;            ///< the larger of the two.
  float cx, cy;           ///< principal point, in cells: an integer part is the column or row of a pixel.
  float width, height;    ///< of the whole view [px]
  float map_x, map_y;     ///< first column and row of the map.
  float map_width, map_height;
  const PixelPlane* planes;  ///< 2 + map_width * map_height.
};

constexpr int kBlockSide = 8;  ///< voxels.
constexpr int kBlockVoxels = kBlockSide * kBlockSide * kBlockSide;
/// How far behind a surface a view counts, if the truncation is not less [voxels].
constexpr float kMaxBehind = 3.0F;
constexpr int kOutsideImage = 0;  ///< entry of TsdfViewParams::planes.
constexpr int kOutsideMap = 1;
constexpr int kFirstPixel = 2;

/// Where the first voxel of a block is in the camera's frame. In double: the camera may be far away.
S2GS_HD inline void BlockInCamera(const TsdfViewParams& view, int block_x, int block_y, int block_z,
                                  float* x_in_cam) {
  const double x = kBlockSide * static_cast<double>(block_x);
  const double y = kBlockSide * static_cast<double>(block_y);
  const double z = kBlockSide * static_cast<double>(block_z);
  for (int i = 0; i < 3; ++i) {
    const double* row = view.rotation + 3 * i;
    x_in_cam[i] = static_cast<float>(row[0] * x + row[1] * y + row[2] * z + view.translation[i]);
  }
}

struct TsdfVoxelParams {
  float inverse_voxel_size;
  float truncation;    ///< [voxels]
  float weight_scale;  ///< of pixels: those at the median depth come to about 1, as empty space does.
};

/// The entry of the view's planes that a point of the camera's frame falls on. Branch-free.
S2GS_HD inline int PlaneIndex(const TsdfViewParams& view, float x, float y, float z) {
  const float inverse_z = 1.0F / z;
  const float u = view.fx * x * inverse_z + view.cx;
  const float v = view.fy * y * inverse_z + view.cy;
  // Comparisons with NaN are false: such points are outside.
  const bool in_image = (z > 0.0F) & (u >= 0.0F) & (v >= 0.0F) & (u < view.width) & (v < view.height);
  const float map_u = u - view.map_x;
  const float map_v = v - view.map_y;
  const bool in_map =
      in_image & (map_u >= 0.0F) & (map_v >= 0.0F) & (map_u < view.map_width) & (map_v < view.map_height);
  const int column = static_cast<int>(in_map ? map_u : 0.0F);
  const int row = static_cast<int>(in_map ? map_v : 0.0F);
  const int pixel = kFirstPixel + row * static_cast<int>(view.map_width) + column;
  return in_map ? pixel : (in_image ? kOutsideMap : kOutsideImage);
}

/// What one view says of one voxel: a signed distance, positive outside, at most the truncation [voxels], and
/// its weight, 0 when it says nothing.
/// The distance is that to the plane that the voxel's pixel sees, rather than the distance along the ray,
/// which is too long by the cosine of the viewing angle and biases the mean of many views. Behind the surface
/// the weight falls to zero (Curless and Levoy, SIGGRAPH 1996), and soon: such voxels are hidden, perhaps by
/// an edge beyond which they lie outside, and only the one next to the surface is needed. Where no object is
/// seen the space is empty: it counts once the nearest pixel of the object is further than the truncation,
/// because only there is the truncated distance known. Branch-free.
/// \param focal  of the view [px]. \param a, b, c, plane_weight  of the voxel's PixelPlane; plain numbers, or
/// compilers do not vectorise.
S2GS_HD inline void SamplePlane(const TsdfVoxelParams& params, float focal, float a, float b, float c,
                                float plane_weight, float x, float y, float z, float* out_distance,
                                float* out_weight) {
  const float dot = a * x + b * y + c * z;  // depth of the voxel over that of the surface
  const float norm2 = a * a + b * b + c * c;
  const float scale = params.inverse_voxel_size / sqrtf(norm2 + 1e-30F);
  const float distance = (1.0F - dot) * scale;
  const float truncation = params.truncation;
  const float behind = truncation < kMaxBehind ? truncation : kMaxBehind;
  // Along the ray the far side of a steep surface is seen through more of it.
  const bool near_ray = z * params.inverse_voxel_size * (dot - 1.0F) <= 2.0F * behind * dot;
  const bool seen = (plane_weight > 0.0F) & (distance > -behind) & (dot > 0.0F) & near_ray;
  const float fall = (distance + behind) / (behind - 1.0F);
  const float drop = fall < 1.0F ? fall : 1.0F;
  // Pixels times depth over focal length is a length.
  const bool empty = -plane_weight * z * params.inverse_voxel_size > truncation * focal;
  const float clipped = distance < truncation ? distance : truncation;
  const float seen_weight = plane_weight * params.weight_scale * drop;
  const float empty_weight = empty ? 1.0F : 0.0F;
  *out_distance = seen ? clipped : truncation;
  *out_weight = seen ? seen_weight : empty_weight;
}

}  // namespace s2gs
