#pragma once

#include <cstddef>
#include <cstdint>

// The inner loops over pixels, in vectors of eight. They are the vector form of kernel/intersect.h,
// kernel/composite.h, kernel/loss.h and kernel/adam.h, branches turned into masks; tests hold the two
// together. Compiled once for every x86 (or any other processor) and once for AVX2 with FMA; this header
// therefore has plain data only.

namespace s2gs {

constexpr int kTileSize = 16;  ///< edge of a tile [px].
constexpr int kPackWidth = 8;  ///< pixels of a row that are computed together.
constexpr int kTilePacks = kTileSize * kTileSize / kPackWidth;

/// A splat of one view: kernel/composite.h's Splat with its bounds.
struct SplatRow {
  float x, y;                    ///< projected centre [px].
  float ux, uy, vx, vy, wx, wy;  ///< footprint.
  float depth;
  float nx, ny, nz;
  float opacity;
  float red, green, blue;
  float foreground;
  float cutoff2;                           ///< r^2 beyond which alpha is below its minimum, with some slack.
  int32_t x_begin, y_begin, x_end, y_end;  ///< pixels that it can reach.
};

/// The loss by a splat's fields, of one tile or summed.
struct SplatGradient {
  float x, y, ux, uy, vx, vy, wx, wy;
  float opacity;
  float red, green, blue;
  float foreground;
  float depth, nx, ny, nz;
};
constexpr int kSplatGradientFloats = 17;

/// A splat in the list of a tile, in order of depth.
struct TileEntry {
  uint32_t splat;  ///< row.
  uint32_t slot;   ///< where its gradient in this tile, or its peak, goes.
};

/// Maps of the view, each `stride` floats a row; padded to whole tiles. Null: not wanted.
struct ViewPlanes {
  size_t stride = 0;
  float* transmittance = nullptr;
  float* color[3] = {};  ///< without the background.
  float* foreground = nullptr;
  float* normal[3] = {};
  float* weight = nullptr;  ///< sum of w.
  float* depth = nullptr;   ///< sum of w z.
  float* median = nullptr;
  float* distortion = nullptr;
  float* m1 = nullptr;
  float* m2 = nullptr;
  int32_t* stop = nullptr;  ///< position in the tile's list of the first splat not added.
};

/// The loss by the maps: kernel/composite.h's PixelGradient. `color` by the colour with its background.
struct ViewGradients {
  float* color[3] = {};
  float* alpha = nullptr;
  float* foreground = nullptr;
  float* normal[3] = {};
  float* expected_depth = nullptr;
  float* distortion = nullptr;
};

struct TileJob {
  const SplatRow* splats;
  const TileEntry* entries;
  int32_t num_entries;
  int32_t x0, y0;  ///< first pixel.
  float near_depth;
  float background[3];
  ViewPlanes planes;
  ViewGradients gradients;        ///< backward only.
  SplatGradient* by_slot;         ///< backward: written for every entry.
  float* peak_by_slot = nullptr;  ///< forward: the largest weight of every entry; null: not wanted.
};

/// SSIM and L1 of one channel, `width` x `height` values each. All buffers have rows of `stride` floats, and
/// at least 8 zeros before and after each row's `width` values rounded up to a multiple of 8.
struct PhotoLossJob {
  int width, height;
  size_t stride;
  const float* rendered;  ///< with its background, in [0, 1] or beyond.
  const float* photo;
  float* scratch[5];              ///< sums across rows.
  float *by_square, *by_product;  ///< derivatives of SSIM.
  float* d_rendered;              ///< out: the loss by `rendered`.
  float l1_weight, ssim_weight;   ///< by a single value of L1, and of SSIM.
  double* l1_rows;                ///< sum of |difference| of each row.
  double* ssim_rows;              ///< sum of SSIM of each row.
};

/// One processor's versions. Channel flags as kernel/composite.h's Channels.
struct TileKernels {
  const char* name;
  void (*forward)(const TileJob& job, bool geometry, bool foreground);
  void (*backward)(const TileJob& job, bool geometry, bool foreground);
  /// Four passes over the photo, each over rows [begin, end), each after all of the one before.
  void (*photo_loss)(const PhotoLossJob& job, int pass, int row_begin, int row_end);
  /// Adam over `count` parameters; `rate` includes nothing else.
  void (*adam)(float rate, float first_correction, float second_correction, const float* gradient,
               size_t count, float* parameter, float* first_moment, float* second_moment);
};

const TileKernels& PortableTileKernels();
#if defined(__x86_64__)
const TileKernels& Avx2TileKernels();
#endif
/// The fastest that this processor has.
const TileKernels& BestTileKernels();

}  // namespace s2gs
