#include "s2gs/core/cuda.h"
#include "s2gs/cuda/losses.h"
#include "s2gs/kernel/foreground.h"
#include "s2gs/kernel/loss.h"

namespace s2gs::cuda {
namespace {

constexpr int kHalo = kTile + 2 * kSsimRadius;
constexpr int kThreads = 256;
static_assert(kThreads == kTileThreads);

// Adds the block's sum of a loss term to the term's own sum and, weighted, to the total. All threads must
// call it.
__device__ void AddTerm(float value, float weight, double* term, LossSums* sums) {
  __shared__ float warp_sums[kThreads / 32];
  value = WarpSum(value);
  __syncthreads();
  if (threadIdx.x % 32 == 0) warp_sums[threadIdx.x / 32] = value;
  __syncthreads();
  if (threadIdx.x != 0) return;
  double sum = 0;
  for (const float warp_sum : warp_sums) sum += static_cast<double>(warp_sum);
  if (sum == 0) return;
  atomicAdd(term, sum);
  atomicAdd(&sums->total, static_cast<double>(weight) * sum);
}

// Rendered and real colour of a pixel.
struct ColorPair {
  float rendered, real;
};

__device__ ColorPair LoadColors(const ImageLossInput& in, const Maps& maps, size_t size, int x, int y,
                                int channel) {
  const size_t i = static_cast<size_t>(y) * in.photo.width + x;
  const float background = channel == 0 ? in.background.x : channel == 1 ? in.background.y : in.background.z;
  const bool is_cut_out = in.cut_out_mask && in.photo.mask != nullptr && in.photo.mask[i] <= 127;
  const float real =
      is_cut_out ? background : static_cast<float>(in.photo.rgb[3 * i + channel]) * (1 / 255.0F);
  const bool is_met =
      in.is_listed != nullptr && in.is_listed[y / kTile * NumTiles(in.photo.width) + x / kTile] == 0;
  const float rendered = is_met ? real : maps.color[channel * size + i] + maps.transmittance[i] * background;
  return {rendered, real};
}

// Windowed moments of both images, SSIM and its partial derivatives; one tile and channel a block.
__global__ __launch_bounds__(kTileThreads) void SsimKernel(ImageLossInput in, Maps maps, float* partials,
                                                           LossSums* sums) {
  __shared__ float2 pixels[kHalo][kHalo];
  __shared__ float rows[5][kHalo][kTile];
  const int channel = static_cast<int>(blockIdx.z);
  const int x0 = static_cast<int>(blockIdx.x) * kTile, y0 = static_cast<int>(blockIdx.y) * kTile;
  const int thread = static_cast<int>(threadIdx.x);
  const int width = in.photo.width, height = in.photo.height;
  const size_t size = static_cast<size_t>(width) * height;
  for (int i = thread; i < kHalo * kHalo; i += kTileThreads) {
    const int x = x0 + i % kHalo - kSsimRadius, y = y0 + i / kHalo - kSsimRadius;
    float2 pair = {0, 0};
    if (x >= 0 && x < width && y >= 0 && y < height) {
      const ColorPair colors = LoadColors(in, maps, size, x, y, channel);
      pair = {colors.rendered, colors.real};
    }
    pixels[i / kHalo][i % kHalo] = pair;
  }
  __syncthreads();
  for (int i = thread; i < kHalo * kTile; i += kTileThreads) {
    const int row = i / kTile, column = i % kTile;
    float x = 0, y = 0, xx = 0, yy = 0, xy = 0;
#pragma unroll
    for (int k = 0; k < kSsimWindow; ++k) {
      const float2 pair = pixels[row][column + k];
      const float w = SsimWeight<float>(k);
      const float wx = w * pair.x, wy = w * pair.y;
      x += wx;
      y += wy;
      xx += wx * pair.x;
      yy += wy * pair.y;
      xy += wx * pair.y;
    }
    rows[0][row][column] = x;
    rows[1][row][column] = y;
    rows[2][row][column] = xx;
    rows[3][row][column] = yy;
    rows[4][row][column] = xy;
  }
  __syncthreads();
  const int tx = thread % kTile, ty = thread / kTile;
  const int x = x0 + tx, y = y0 + ty;
  float dissimilarity = 0;
  if (x < width && y < height) {
    float moments[5] = {0, 0, 0, 0, 0};
#pragma unroll
    for (int k = 0; k < kSsimWindow; ++k) {
      const float w = SsimWeight<float>(k);
#pragma unroll
      for (int m = 0; m < 5; ++m) moments[m] += w * rows[m][ty + k][tx];
    }
    const SsimPoint<float> point =
        ComputeSsimPoint(moments[0], moments[1], moments[2], moments[3], moments[4]);
    const size_t at = static_cast<size_t>(y) * width + x;
    float* out = partials + static_cast<size_t>(3 * channel) * size + at;
    out[0] = point.by_mean;
    out[size] = point.by_square;
    out[2 * size] = point.by_product;
    dissimilarity = 1 - point.value;
  }
  if (in.report->overflow == 0) {
    const float share = dissimilarity / (3 * static_cast<float>(size));
    AddTerm(share, in.weights.dssim, &sums->dssim, sums);
  }
}

// Loss by the rendered colours: the window applied once more to the partial derivatives, and L1.
__global__ __launch_bounds__(kTileThreads) void ColorGradientKernel(ImageLossInput in, Maps maps,
                                                                    const float* partials, float* d_color,
                                                                    LossSums* sums) {
  __shared__ float pixels[3][kHalo][kHalo];
  __shared__ float rows[3][kHalo][kTile];
  const int channel = static_cast<int>(blockIdx.z);
  const int x0 = static_cast<int>(blockIdx.x) * kTile, y0 = static_cast<int>(blockIdx.y) * kTile;
  const int thread = static_cast<int>(threadIdx.x);
  const int width = in.photo.width, height = in.photo.height;
  const size_t size = static_cast<size_t>(width) * height;
  const int tx = thread % kTile, ty = thread / kTile;
  const int x = x0 + tx, y = y0 + ty;
  float windowed[3] = {0, 0, 0};
  if (in.weights.dssim != 0) {
    const float* source = partials + static_cast<size_t>(3 * channel) * size;
    for (int i = thread; i < kHalo * kHalo; i += kTileThreads) {
      const int column = x0 + i % kHalo - kSsimRadius, row = y0 + i / kHalo - kSsimRadius;
      const bool is_inside = column >= 0 && column < width && row >= 0 && row < height;
      const size_t at = is_inside ? static_cast<size_t>(row) * width + column : 0;
#pragma unroll
      for (int m = 0; m < 3; ++m) pixels[m][i / kHalo][i % kHalo] = is_inside ? source[m * size + at] : 0;
    }
    __syncthreads();
    for (int i = thread; i < kHalo * kTile; i += kTileThreads) {
      const int row = i / kTile, column = i % kTile;
      float sum[3] = {0, 0, 0};
#pragma unroll
      for (int k = 0; k < kSsimWindow; ++k) {
#pragma unroll
        for (int m = 0; m < 3; ++m) sum[m] += SsimWeight<float>(k) * pixels[m][row][column + k];
      }
#pragma unroll
      for (int m = 0; m < 3; ++m) rows[m][row][column] = sum[m];
    }
    __syncthreads();
#pragma unroll
    for (int k = 0; k < kSsimWindow; ++k) {
#pragma unroll
      for (int m = 0; m < 3; ++m) windowed[m] += SsimWeight<float>(k) * rows[m][ty + k][tx];
    }
  }
  const float share = 1 / (3 * static_cast<float>(size));
  float difference = 0;
  if (x < width && y < height) {
    const ColorPair colors = LoadColors(in, maps, size, x, y, channel);
    difference = fabsf(colors.rendered - colors.real);
    float gradient = (1 - in.weights.dssim) * L1Adjoint(colors.rendered, colors.real);
    if (in.weights.dssim != 0) {
      gradient -=
          in.weights.dssim * SsimAdjoint(windowed[0], windowed[1], windowed[2], colors.rendered, colors.real);
    }
    d_color[static_cast<size_t>(channel) * size + static_cast<size_t>(y) * width + x] = share * gradient;
  }
  if (in.report->overflow == 0) AddTerm(share * difference, 1 - in.weights.dssim, &sums->l1, sums);
}

template <bool kGeometry, bool kForeground>
__global__ __launch_bounds__(kThreads) void MapLossKernel(ImageLossInput in, Maps maps, MapGradients d_maps,
                                                          LossSums* sums) {
  const int width = in.photo.width, height = in.photo.height;
  const int size = width * height;
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  const float share = 1 / static_cast<float>(size);
  float entropy = 0, cross_entropy = 0, inconsistency = 0, distortion = 0;
  if (i < size) {
    if constexpr (kForeground) {
      const float p = maps.foreground[i];
      float d = 0;
      if (in.weights.entropy_2d != 0) {
        entropy = EntropyOfProbability(p);
        d += in.weights.entropy_2d * EntropyOfProbabilityAdjoint(p);
      }
      if (in.weights.mask != 0 && in.photo.mask != nullptr) {
        const bool is_inside = in.photo.mask[i] > 127;
        cross_entropy = MaskCrossEntropy(p, is_inside);
        d += in.weights.mask * MaskCrossEntropyAdjoint(p, is_inside);
      }
      d_maps.foreground[i] = share * d;
    }
    if constexpr (kGeometry) {
      if (in.weights.distortion != 0) {
        distortion = maps.distortion[i];
        d_maps.distortion[i] = share * in.weights.distortion;
      }
      const int x = i % width, y = i / width;
      Vec3<float> d_normal = {0, 0, 0};
      float d_alpha = 0;
      if (in.weights.normal != 0 && x > 0 && y > 0 && x < width - 1 && y < height - 1) {
        const auto depth = [&](int at) {
          const float weight = maps.weight[at];
          return weight > 0 ? maps.depth[at] / weight : 0.0F;
        };
        const DepthStencil<float> z = {depth(i - 1), depth(i + 1), depth(i - width), depth(i + width)};
        const float pixel_x = static_cast<float>(x) + 0.5F, pixel_y = static_cast<float>(y) + 0.5F;
        Vec3<float> normal;
        float length = 0;
        if (NormalFromDepth(z, pixel_x, pixel_y, in.fx, in.fy, in.cx, in.cy, &normal, &length)) {
          const Vec3<float> rendered = {maps.normal[i], maps.normal[size + i], maps.normal[2 * size + i]};
          inconsistency = 1 - maps.transmittance[i] - Dot(rendered, normal);
          const float weight = share * in.weights.normal;
          d_alpha = weight;
          d_normal = -weight * normal;
          const DepthStencil<float> d = NormalFromDepthAdjoint(z, pixel_x, pixel_y, in.fx, in.fy, in.cx,
                                                               in.cy, normal, length, -weight * rendered);
          atomicAdd(d_maps.expected_depth + i - 1, d.left);
          atomicAdd(d_maps.expected_depth + i + 1, d.right);
          atomicAdd(d_maps.expected_depth + i - width, d.up);
          atomicAdd(d_maps.expected_depth + i + width, d.down);
        }
      }
      d_maps.alpha[i] = d_alpha;
      d_maps.normal[i] = d_normal.x;
      d_maps.normal[size + i] = d_normal.y;
      d_maps.normal[2 * size + i] = d_normal.z;
    }
  }
  if (in.report->overflow != 0) return;
  if constexpr (kForeground) {
    AddTerm(share * entropy, in.weights.entropy_2d, &sums->entropy_2d, sums);
    AddTerm(share * cross_entropy, in.weights.mask, &sums->mask, sums);
  }
  if constexpr (kGeometry) {
    AddTerm(share * inconsistency, in.weights.normal, &sums->normal, sums);
    AddTerm(share * distortion, in.weights.distortion, &sums->distortion, sums);
  }
}

__global__ __launch_bounds__(kThreads) void ModelLossKernel(ModelLossInput in, float* d_logits,
                                                            LossSums* sums) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  float divergence = 0, entropy = 0;
  if (i < in.count) {
    const float logit = in.foreground_logits[i];
    float d = 0;
    if (isfinite(logit)) {
      if (in.entropy_3d != 0) {
        const float share = 1 / static_cast<float>(in.count);
        entropy = share * EntropyOfLogit(logit);
        d += in.entropy_3d * share * EntropyOfLogitAdjoint(logit);
      }
      if (in.local_consistency != 0) {
        const float share = 1 / (static_cast<float>(in.count) * static_cast<float>(in.num_neighbours));
        const float weight = in.local_consistency * share;
        for (int k = 0; k < in.num_neighbours; ++k) {
          const uint32_t j = in.neighbours[static_cast<size_t>(k) * in.count + i];
          const float other = in.foreground_logits[j];
          if (!isfinite(other)) continue;
          divergence += share * KlOfLogits(logit, other);
          float by_own = 0, by_other = 0;
          KlOfLogitsAdjoint(logit, other, &by_own, &by_other);
          d += weight * by_own;
          if (by_other != 0) atomicAdd(d_logits + j, weight * by_other);
        }
      }
    }
    if (d != 0) atomicAdd(d_logits + i, d);
  }
  if (in.report->overflow != 0) return;
  AddTerm(divergence, in.local_consistency, &sums->local_consistency, sums);
  AddTerm(entropy, in.entropy_3d, &sums->entropy_3d, sums);
}

}  // namespace

void ColorLoss(const ImageLossInput& input, const Maps& maps, const MapGradients& d_maps, float* partials,
               LossSums* sums, cudaStream_t stream) {
  const dim3 grid(NumTiles(input.photo.width), NumTiles(input.photo.height), 3);
  if (input.weights.dssim != 0) SsimKernel<<<grid, kTileThreads, 0, stream>>>(input, maps, partials, sums);
  ColorGradientKernel<<<grid, kTileThreads, 0, stream>>>(input, maps, partials, d_maps.color, sums);
  CheckCuda(cudaGetLastError(), "loss of the colours");
}

void MapLoss(const ImageLossInput& input, bool geometry, bool foreground, const Maps& maps,
             const MapGradients& d_maps, LossSums* sums, cudaStream_t stream) {
  const int64_t size = static_cast<int64_t>(input.photo.width) * input.photo.height;
  const unsigned blocks = NumBlocks(size, kThreads);
  if (geometry) {
    CheckCuda(cudaMemsetAsync(d_maps.expected_depth, 0, sizeof(float) * size, stream), "depth gradient");
  }
  if (geometry && foreground) {
    MapLossKernel<true, true><<<blocks, kThreads, 0, stream>>>(input, maps, d_maps, sums);
  } else if (geometry) {
    MapLossKernel<true, false><<<blocks, kThreads, 0, stream>>>(input, maps, d_maps, sums);
  } else if (foreground) {
    MapLossKernel<false, true><<<blocks, kThreads, 0, stream>>>(input, maps, d_maps, sums);
  }
  CheckCuda(cudaGetLastError(), "loss of the maps");
}

void ModelLoss(const ModelLossInput& input, float* d_logits, LossSums* sums, cudaStream_t stream) {
  CheckCuda(cudaMemsetAsync(d_logits, 0, sizeof(float) * input.count, stream), "gradient of p");
  ModelLossKernel<<<NumBlocks(input.count, kThreads), kThreads, 0, stream>>>(input, d_logits, sums);
  CheckCuda(cudaGetLastError(), "loss of the model");
}

}  // namespace s2gs::cuda
