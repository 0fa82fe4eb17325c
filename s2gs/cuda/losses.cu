#include "s2gs/core/cuda.h"
#include "s2gs/cuda/losses.h"
#include "s2gs/kernel/foreground.h"
#include "s2gs/kernel/loss.h"

namespace s2gs::cuda {
namespace {

constexpr int kThreads = 256;

// The block of pixels that the loss of the colours looks at together, and so many of a column a thread, which
// reads what their windows share once.
constexpr int kLossWidth = 32, kLossHeight = 16;
constexpr int kOutputs = 4;
constexpr int kLossThreads = kLossWidth * kLossHeight / kOutputs;
constexpr int kHaloWidth = kLossWidth + 2 * kSsimRadius, kHaloHeight = kLossHeight + 2 * kSsimRadius;
// Rows are padded so that lanes that stand for rows use different banks.
constexpr int kPaddedHalo = kHaloWidth + 1, kPaddedWidth = kLossWidth + 1;
static_assert(kPaddedHalo % 2 == 1 && kPaddedWidth % 2 == 1);

// Sums kCount values of neighbouring places with the window's weights, for kOutputs windows, each a place
// further than the last. value(i, v) gives those at place i.
template <int kCount, typename Value>
__device__ void SumWindows(const Value& value, float (&sums)[kOutputs][kCount]) {
#pragma unroll
  for (int output = 0; output < kOutputs; ++output) {
#pragma unroll
    for (int m = 0; m < kCount; ++m) sums[output][m] = 0;
  }
#pragma unroll
  for (int i = 0; i < kSsimWindow + kOutputs - 1; ++i) {
    float values[kCount];
    value(i, values);
#pragma unroll
    for (int output = 0; output < kOutputs; ++output) {
      const int k = i - output;
      if (k < 0 || k >= kSsimWindow) continue;
#pragma unroll
      for (int m = 0; m < kCount; ++m) sums[output][m] += SsimWeight<float>(k) * values[m];
    }
  }
}

// Along the rows of a block with its halo: `rows` gets a plane for each of kCount values that value(row,
// column, v) gives.
template <int kCount, typename Value>
__device__ void SumAlongRows(const Value& value, float (*rows)[kHaloHeight][kPaddedWidth]) {
  for (int i = static_cast<int>(threadIdx.x); i < kHaloHeight * kLossWidth / kOutputs; i += kLossThreads) {
    const int row = i % kHaloHeight, column = i / kHaloHeight * kOutputs;
    float sums[kOutputs][kCount];
    SumWindows<kCount>([&](int k, float* v) { value(row, column + k, v); }, sums);
#pragma unroll
    for (int output = 0; output < kOutputs; ++output) {
#pragma unroll
      for (int m = 0; m < kCount; ++m) rows[m][row][column + output] = sums[output][m];
    }
  }
}

// Adds the sum of a loss term over the block's kCount threads to the term's own sum and, weighted, to the
// total. All threads must call it.
template <int kCount = kThreads>
__device__ void AddTerm(float value, float weight, double* term, LossSums* sums) {
  __shared__ float warp_sums[kCount / 32];
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

// Windowed moments of both images, SSIM and its partial derivatives; one block of pixels and channel a block.
__global__ __launch_bounds__(kLossThreads) void SsimKernel(ImageLossInput in, Maps maps, float* partials,
                                                           LossSums* sums) {
  __shared__ float2 pixels[kHaloHeight][kPaddedHalo];
  __shared__ float rows[5][kHaloHeight][kPaddedWidth];
  const int channel = static_cast<int>(blockIdx.z);
  const int x0 = static_cast<int>(blockIdx.x) * kLossWidth, y0 = static_cast<int>(blockIdx.y) * kLossHeight;
  const int thread = static_cast<int>(threadIdx.x);
  const int width = in.photo.width, height = in.photo.height;
  const size_t size = static_cast<size_t>(width) * height;
  for (int i = thread; i < kHaloHeight * kHaloWidth; i += kLossThreads) {
    const int x = x0 + i % kHaloWidth - kSsimRadius, y = y0 + i / kHaloWidth - kSsimRadius;
    float2 pair = {0, 0};
    if (x >= 0 && x < width && y >= 0 && y < height) {
      const ColorPair colors = LoadColors(in, maps, size, x, y, channel);
      pair = {colors.rendered, colors.real};
    }
    pixels[i / kHaloWidth][i % kHaloWidth] = pair;
  }
  __syncthreads();
  SumAlongRows<5>(
      [&](int row, int column, float* v) {
        const float2 pair = pixels[row][column];
        v[0] = pair.x;
        v[1] = pair.y;
        v[2] = pair.x * pair.x;
        v[3] = pair.y * pair.y;
        v[4] = pair.x * pair.y;
      },
      rows);
  __syncthreads();
  const int column = thread % kLossWidth, first_row = thread / kLossWidth * kOutputs;
  float moments[kOutputs][5];
  SumWindows<5>(
      [&](int k, float* v) {
#pragma unroll
        for (int m = 0; m < 5; ++m) v[m] = rows[m][first_row + k][column];
      },
      moments);
  float dissimilarity = 0;
#pragma unroll
  for (int output = 0; output < kOutputs; ++output) {
    const int x = x0 + column, y = y0 + first_row + output;
    if (x >= width || y >= height) continue;
    const float* m = moments[output];
    const SsimPoint<float> point = ComputeSsimPoint(m[0], m[1], m[2], m[3], m[4]);
    float* out = partials + static_cast<size_t>(3 * channel) * size + static_cast<size_t>(y) * width + x;
    out[0] = point.by_mean;
    out[size] = point.by_square;
    out[2 * size] = point.by_product;
    dissimilarity += 1 - point.value;
  }
  if (in.report->overflow == 0) {
    const float share = dissimilarity / (3 * static_cast<float>(size));
    AddTerm<kLossThreads>(share, in.weights.dssim, &sums->dssim, sums);
  }
}

// Loss by the rendered colours: the window applied once more to the partial derivatives, and L1.
__global__ __launch_bounds__(kLossThreads) void ColorGradientKernel(ImageLossInput in, Maps maps,
                                                                    const float* partials, float* d_color,
                                                                    LossSums* sums) {
  __shared__ float pixels[3][kHaloHeight][kPaddedHalo];
  __shared__ float rows[3][kHaloHeight][kPaddedWidth];
  const int channel = static_cast<int>(blockIdx.z);
  const int x0 = static_cast<int>(blockIdx.x) * kLossWidth, y0 = static_cast<int>(blockIdx.y) * kLossHeight;
  const int thread = static_cast<int>(threadIdx.x);
  const int width = in.photo.width, height = in.photo.height;
  const size_t size = static_cast<size_t>(width) * height;
  const int column = thread % kLossWidth, first_row = thread / kLossWidth * kOutputs;
  float windowed[kOutputs][3] = {};
  if (in.weights.dssim != 0) {
    const float* source = partials + static_cast<size_t>(3 * channel) * size;
    for (int i = thread; i < kHaloHeight * kHaloWidth; i += kLossThreads) {
      const int x = x0 + i % kHaloWidth - kSsimRadius, y = y0 + i / kHaloWidth - kSsimRadius;
      const bool is_inside = x >= 0 && x < width && y >= 0 && y < height;
      const size_t at = is_inside ? static_cast<size_t>(y) * width + x : 0;
#pragma unroll
      for (int m = 0; m < 3; ++m)
        pixels[m][i / kHaloWidth][i % kHaloWidth] = is_inside ? source[m * size + at] : 0;
    }
    __syncthreads();
    SumAlongRows<3>(
        [&](int row, int at, float* v) {
#pragma unroll
          for (int m = 0; m < 3; ++m) v[m] = pixels[m][row][at];
        },
        rows);
    __syncthreads();
    SumWindows<3>(
        [&](int k, float* v) {
#pragma unroll
          for (int m = 0; m < 3; ++m) v[m] = rows[m][first_row + k][column];
        },
        windowed);
  }
  const float share = 1 / (3 * static_cast<float>(size));
  float difference = 0;
#pragma unroll
  for (int output = 0; output < kOutputs; ++output) {
    const int x = x0 + column, y = y0 + first_row + output;
    if (x >= width || y >= height) continue;
    const ColorPair colors = LoadColors(in, maps, size, x, y, channel);
    difference += fabsf(colors.rendered - colors.real);
    float gradient = (1 - in.weights.dssim) * L1Adjoint(colors.rendered, colors.real);
    if (in.weights.dssim != 0) {
      const float* w = windowed[output];
      gradient -= in.weights.dssim * SsimAdjoint(w[0], w[1], w[2], colors.rendered, colors.real);
    }
    d_color[static_cast<size_t>(channel) * size + static_cast<size_t>(y) * width + x] = share * gradient;
  }
  if (in.report->overflow == 0) {
    AddTerm<kLossThreads>(share * difference, 1 - in.weights.dssim, &sums->l1, sums);
  }
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
  const dim3 grid(NumBlocks(input.photo.width, kLossWidth), NumBlocks(input.photo.height, kLossHeight), 3);
  if (input.weights.dssim != 0) SsimKernel<<<grid, kLossThreads, 0, stream>>>(input, maps, partials, sums);
  ColorGradientKernel<<<grid, kLossThreads, 0, stream>>>(input, maps, partials, d_maps.color, sums);
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
