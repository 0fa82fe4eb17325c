#include <cub/device/device_radix_sort.cuh>
#include <type_traits>

#include "s2gs/cuda/knn.h"

namespace s2gs::cuda {
namespace {

constexpr int kThreads = 128;
constexpr int kBox = 64;         // points of a box,
constexpr int kBoxesOfOne = 32;  // and boxes of a large one.
constexpr int kBits = 21;        // of the Morton code, per axis.

// Unsigned integers in the order of floats.
__device__ uint32_t Ordered(float value) {
  const uint32_t bits = __float_as_uint(value);
  return (bits & 0x80000000U) != 0 ? ~bits : bits | 0x80000000U;
}
__device__ float FromOrdered(uint32_t ordered) {
  return __uint_as_float((ordered & 0x80000000U) != 0 ? ordered & 0x7FFFFFFFU : ~ordered);
}

__global__ void ResetBoundsKernel(uint32_t* bounds) {
  if (threadIdx.x < 6) bounds[threadIdx.x] = threadIdx.x < 3 ? 0xFFFFFFFFU : 0;
}

__global__ void BoundsKernel(const float* centres, size_t stride, int count, uint32_t* bounds) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  for (int axis = 0; axis < 3; ++axis) {
    const float value = i < count ? centres[axis * stride + i] : NAN;
    const uint32_t lower = isfinite(value) ? Ordered(value) : 0xFFFFFFFFU;
    const uint32_t upper = isfinite(value) ? Ordered(value) : 0;
    const uint32_t warp_lower = __reduce_min_sync(0xFFFFFFFFU, lower);
    const uint32_t warp_upper = __reduce_max_sync(0xFFFFFFFFU, upper);
    if (threadIdx.x % 32 == 0) {
      atomicMin(bounds + axis, warp_lower);
      atomicMax(bounds + 3 + axis, warp_upper);
    }
  }
}

__device__ uint64_t Spread(uint64_t x) {
  x = (x | x << 32) & 0x1F00000000FFFFULL;
  x = (x | x << 16) & 0x1F0000FF0000FFULL;
  x = (x | x << 8) & 0x100F00F00F00F00FULL;
  x = (x | x << 4) & 0x10C30C30C30C30C3ULL;
  return (x | x << 2) & 0x1249249249249249ULL;
}

__global__ void CodesKernel(const float* centres, size_t stride, int count, const uint32_t* bounds,
                            uint64_t* codes, uint32_t* ids) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= count) return;
  uint64_t code = 0;
  for (int axis = 0; axis < 3; ++axis) {
    const float lower = FromOrdered(bounds[axis]), upper = FromOrdered(bounds[3 + axis]);
    const float share = (centres[axis * stride + i] - lower) / fmaxf(upper - lower, 1e-30F);
    const float cell = fminf(fmaxf(share, 0.0F), 1.0F) * static_cast<float>((1 << kBits) - 1);
    code |= Spread(static_cast<uint64_t>(cell)) << axis;
  }
  codes[i] = code;
  ids[i] = static_cast<uint32_t>(i);
}

__global__ void SortPointsKernel(const float* centres, size_t stride, int count, const uint32_t* sorted_ids,
                                 float4* points) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= count) return;
  const uint32_t id = sorted_ids[i];
  points[i] = {centres[id], centres[stride + id], centres[2 * stride + id], 0};
}

__global__ void BoxesKernel(const float4* points, int count, int num_boxes, float4* boxes) {
  const int box = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (box >= num_boxes) return;
  float4 lower = {INFINITY, INFINITY, INFINITY, 0}, upper = {-INFINITY, -INFINITY, -INFINITY, 0};
  for (int i = box * kBox; i < min((box + 1) * kBox, count); ++i) {
    const float4 p = points[i];
    lower = {fminf(lower.x, p.x), fminf(lower.y, p.y), fminf(lower.z, p.z), 0};
    upper = {fmaxf(upper.x, p.x), fmaxf(upper.y, p.y), fmaxf(upper.z, p.z), 0};
  }
  boxes[2 * box] = lower;
  boxes[2 * box + 1] = upper;
}

// Boxes about kBoxesOfOne boxes each.
__global__ void LargeBoxesKernel(const float4* boxes, int num_boxes, int num_large, float4* large) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= num_large) return;
  float4 lower = {INFINITY, INFINITY, INFINITY, 0}, upper = {-INFINITY, -INFINITY, -INFINITY, 0};
  for (int box = i * kBoxesOfOne; box < min((i + 1) * kBoxesOfOne, num_boxes); ++box) {
    const float4 its_lower = boxes[2 * box], its_upper = boxes[2 * box + 1];
    lower = {fminf(lower.x, its_lower.x), fminf(lower.y, its_lower.y), fminf(lower.z, its_lower.z), 0};
    upper = {fmaxf(upper.x, its_upper.x), fmaxf(upper.y, its_upper.y), fmaxf(upper.z, its_upper.z), 0};
  }
  large[2 * i] = lower;
  large[2 * i + 1] = upper;
}

__device__ float DistanceToBox(const float4& p, const float4& lower, const float4& upper) {
  const float x = fmaxf(fmaxf(lower.x - p.x, p.x - upper.x), 0.0F);
  const float y = fmaxf(fmaxf(lower.y - p.y, p.y - upper.y), 0.0F);
  const float z = fmaxf(fmaxf(lower.z - p.z, p.z - upper.z), 0.0F);
  return x * x + y * y + z * z;
}

// The k best so far, nearest first, in registers.
template <int kMax>
struct Nearest {
  float distance[kMax];
  int index[kMax];

  __device__ void Insert(float d, int i) {
    if (!(d < distance[kMax - 1])) return;
      // Carries what is larger on to the end; all indices are compile-time constants.
#pragma unroll
    for (int k = 0; k < kMax; ++k) {
      if (d < distance[k]) {
        const float further = distance[k];
        const int further_index = index[k];
        distance[k] = d;
        index[k] = i;
        d = further;
        i = further_index;
      }
    }
  }
};

template <int kMax>
__device__ void SearchBox(const float4* points, int count, int box, int self, Nearest<kMax>* nearest) {
  const float4 p = points[self];
  for (int i = box * kBox; i < min((box + 1) * kBox, count); ++i) {
    if (i == self) continue;
    const float4 other = points[i];
    const float x = other.x - p.x, y = other.y - p.y, z = other.z - p.z;
    nearest->Insert(x * x + y * y + z * z, i);
  }
}

// \param boxes  the large ones behind the others.
template <int kMax>
__global__ __launch_bounds__(kThreads) void FindKernel(const float4* points, const float4* boxes,
                                                       const uint32_t* sorted_ids, int count, int num_boxes,
                                                       int k, uint32_t* neighbours) {
  const int self = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (self >= count) return;
  Nearest<kMax> nearest;
#pragma unroll
  for (int i = 0; i < kMax; ++i) {
    nearest.distance[i] = INFINITY;
    nearest.index[i] = self == 0 ? 1 : 0;
  }
  const int own = self / kBox;
  SearchBox(points, count, own, self, &nearest);
  if (own > 0) SearchBox(points, count, own - 1, self, &nearest);
  if (own + 1 < num_boxes) SearchBox(points, count, own + 1, self, &nearest);
  const float4 p = points[self];
  const float4* const large = boxes + 2 * num_boxes;
  for (int first = 0; first < num_boxes; first += kBoxesOfOne) {
    const float4* const its = large + 2 * (first / kBoxesOfOne);
    if (DistanceToBox(p, its[0], its[1]) >= nearest.distance[kMax - 1]) continue;
    for (int box = first; box < min(first + kBoxesOfOne, num_boxes); ++box) {
      if (box >= own - 1 && box <= own + 1) continue;
      if (DistanceToBox(p, boxes[2 * box], boxes[2 * box + 1]) >= nearest.distance[kMax - 1]) continue;
      SearchBox(points, count, box, self, &nearest);
    }
  }
  const uint32_t id = sorted_ids[self];
#pragma unroll
  for (int i = 0; i < kMax; ++i) {
    if (i < k) neighbours[static_cast<size_t>(i) * count + id] = sorted_ids[nearest.index[i]];
  }
}

}  // namespace

NeighbourFinder::NeighbourFinder(DeviceMemoryCount* memory)
    : bounds_(memory),
      codes_(memory),
      sorted_codes_(memory),
      ids_(memory),
      sorted_ids_(memory),
      points_(memory),
      boxes_(memory),
      scratch_(memory) {}

void NeighbourFinder::Find(const float* centres, size_t stride, int64_t count, int k, uint32_t* neighbours,
                           cudaStream_t stream) {
  S2GS_INVARIANT(k > 0 && k <= kMaxNeighbours && k < count);
  const auto n = static_cast<int>(count);
  const auto size = static_cast<size_t>(count);
  const int num_boxes = (n + kBox - 1) / kBox;
  const int num_large = (num_boxes + kBoxesOfOne - 1) / kBoxesOfOne;
  bounds_.Reserve(6);
  codes_.Reserve(size);
  sorted_codes_.Reserve(size);
  ids_.Reserve(size);
  sorted_ids_.Reserve(size);
  points_.Reserve(size);
  boxes_.Reserve(2 * static_cast<size_t>(num_boxes + num_large));
  const unsigned blocks = NumBlocks(n, kThreads);
  ResetBoundsKernel<<<1, 32, 0, stream>>>(bounds_.get());
  BoundsKernel<<<blocks, kThreads, 0, stream>>>(centres, stride, n, bounds_.get());
  CodesKernel<<<blocks, kThreads, 0, stream>>>(centres, stride, n, bounds_.get(), codes_.get(), ids_.get());
  size_t bytes = 0;
  CheckCuda(cub::DeviceRadixSort::SortPairs(nullptr, bytes, codes_.get(), sorted_codes_.get(), ids_.get(),
                                            sorted_ids_.get(), n, 0, 3 * kBits, stream),
            "Morton order");
  scratch_.Reserve(bytes);
  CheckCuda(cub::DeviceRadixSort::SortPairs(scratch_.get(), bytes, codes_.get(), sorted_codes_.get(),
                                            ids_.get(), sorted_ids_.get(), n, 0, 3 * kBits, stream),
            "Morton order");
  SortPointsKernel<<<blocks, kThreads, 0, stream>>>(centres, stride, n, sorted_ids_.get(), points_.get());
  BoxesKernel<<<NumBlocks(num_boxes, kThreads), kThreads, 0, stream>>>(points_.get(), n, num_boxes,
                                                                       boxes_.get());
  LargeBoxesKernel<<<NumBlocks(num_large, kThreads), kThreads, 0, stream>>>(
      boxes_.get(), num_boxes, num_large, boxes_.get() + 2 * static_cast<size_t>(num_boxes));
  const auto find = [&](auto most) {
    FindKernel<decltype(most)::value><<<blocks, kThreads, 0, stream>>>(
        points_.get(), boxes_.get(), sorted_ids_.get(), n, num_boxes, k, neighbours);
  };
  // A list longer than k looks farther than it needs to.
  if (k <= 3) {
    find(std::integral_constant<int, 3>());
  } else if (k <= 5) {
    find(std::integral_constant<int, 5>());
  } else if (k <= 8) {
    find(std::integral_constant<int, 8>());
  } else if (k <= 16) {
    find(std::integral_constant<int, 16>());
  } else {
    find(std::integral_constant<int, kMaxNeighbours>());
  }
  CheckCuda(cudaGetLastError(), "nearest neighbours");
}

}  // namespace s2gs::cuda
