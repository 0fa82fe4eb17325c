#include <cub/device/device_radix_sort.cuh>
#include <cub/device/device_scan.cuh>
#include <limits>

#include "s2gs/cuda/densify.h"
#include "s2gs/kernel/densify.h"

namespace s2gs::cuda {
namespace {

constexpr int kThreads = 256;
constexpr int kNumActions = 5;

// How a Gaussian of the new model came about.
enum Birth : uint8_t { kOld, kCopy, kFirstChild, kSecondChild };

__device__ DensifyAction Decide(const Planes& parameters, int i, float gradient, const DensifyRule& rule) {
  bool is_finite = true;
  for (int plane = kShDc; plane < kNumPlanes; ++plane)
    is_finite = is_finite && isfinite(parameters.At(plane)[i]);
  return DecideDensify(LoadSurfel(parameters, i), is_finite, gradient, rule);
}

__global__ void DecideKernel(Planes parameters, int count, const float* gradient_sum, const float* view_count,
                             DensifyRule rule, uint8_t* actions, uint32_t* keys, uint32_t* ids,
                             unsigned long long* totals) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= count) return;
  const float gradient = MeanGradient(gradient_sum[i], view_count[i]);
  const DensifyAction action = Decide(parameters, i, gradient, rule);
  const bool grows = action == DensifyAction::kClone || action == DensifyAction::kSplit;
  actions[i] = static_cast<uint8_t>(action);
  keys[i] = grows ? __float_as_uint(gradient) + 1 : 0;
  ids[i] = static_cast<uint32_t>(i);
  atomicAdd(totals + static_cast<int>(action), 1ULL);
}

// Those that grow, but come after the first `room` of them by gradient, are decided again without growth.
__global__ void LimitKernel(Planes parameters, int first, int last, const uint32_t* sorted_ids,
                            DensifyRule rule, uint8_t* actions, unsigned long long* totals) {
  const int rank = first + static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (rank >= last) return;
  const auto i = static_cast<int>(sorted_ids[rank]);
  rule.grow = false;
  const DensifyAction action = Decide(parameters, i, 0, rule);
  atomicAdd(totals + actions[i], ~0ULL);  // minus one
  atomicAdd(totals + static_cast<int>(action), 1ULL);
  actions[i] = static_cast<uint8_t>(action);
}

__global__ void FlagKernel(const uint8_t* actions, int count, uint32_t* kept, uint32_t* added) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= count) return;
  const auto action = static_cast<DensifyAction>(actions[i]);
  const bool grows = action == DensifyAction::kClone || action == DensifyAction::kSplit;
  kept[i] = grows || action == DensifyAction::kKeep ? 1 : 0;
  added[i] = grows ? 1 : 0;
}

// kept and added hold exclusive sums.
__global__ void PlaceKernel(const uint8_t* actions, int count, const uint32_t* kept, const uint32_t* added,
                            uint32_t num_kept, uint32_t* sources, uint8_t* births) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= count) return;
  const auto action = static_cast<DensifyAction>(actions[i]);
  if (action == DensifyAction::kRemove || action == DensifyAction::kNotFinite) return;
  const bool splits = action == DensifyAction::kSplit;
  sources[kept[i]] = static_cast<uint32_t>(i);
  births[kept[i]] = splits ? kFirstChild : kOld;
  if (splits || action == DensifyAction::kClone) {
    sources[num_kept + added[i]] = static_cast<uint32_t>(i);
    births[num_kept + added[i]] = splits ? kSecondChild : kCopy;
  }
}

// One plane a row of blocks. \param births  null: all are old.
__global__ void GatherKernel(const uint32_t* sources, const uint8_t* births, int count, const float* from,
                             size_t from_stride, float* to, size_t to_stride) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= count) return;
  const auto plane = static_cast<int>(blockIdx.y);
  const bool is_moment = plane >= kNumPlanes;
  const bool is_new = births != nullptr && births[i] != kOld;
  to[plane * to_stride + i] = is_moment && is_new ? 0.0F : from[plane * from_stride + sources[i]];
}

__global__ void PlaceChildrenKernel(const uint32_t* sources, const uint8_t* births, int count, Planes from,
                                    Planes to, uint64_t seed, int64_t iteration) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= count || births[i] < kFirstChild) return;
  Vec3<float> centre;
  Vec2<float> log_scale;
  SplitChild(LoadSurfel(from, static_cast<int>(sources[i])), seed, iteration, sources[i],
             births[i] == kSecondChild ? 1 : 0, &centre, &log_scale);
  to.At(kCentre)[i] = centre.x;
  to.At(kCentre + 1)[i] = centre.y;
  to.At(kCentre + 2)[i] = centre.z;
  to.At(kLogScale)[i] = log_scale.x;
  to.At(kLogScale + 1)[i] = log_scale.y;
}

}  // namespace

void GatherModel(const uint32_t* sources, const uint8_t* births, int64_t count, const Planes& from,
                 const Planes& to, cudaStream_t stream) {
  if (count == 0) return;
  const dim3 grid(NumBlocks(count, kThreads), 3 * kNumPlanes);
  GatherKernel<<<grid, kThreads, 0, stream>>>(sources, births, static_cast<int>(count), from.data,
                                              from.stride, to.data, to.stride);
  CheckCuda(cudaGetLastError(), "choice of Gaussians");
}

DensifyPlan::DensifyPlan(DeviceMemoryCount* memory)
    : actions_(memory),
      keys_(memory),
      sorted_keys_(memory),
      ids_(memory),
      sorted_ids_(memory),
      kept_(memory),
      added_(memory),
      sources_(memory),
      births_(memory),
      totals_(memory),
      scratch_(memory) {}

DensifyResult DensifyPlan::Make(const Planes& parameters, int64_t count, const float* gradient_sum,
                                const float* view_count, const DensifyStep& step, cudaStream_t stream) {
  const auto n = static_cast<int>(count);
  const auto size = static_cast<size_t>(count);
  actions_.Reserve(size);
  keys_.Reserve(size);
  sorted_keys_.Reserve(size);
  ids_.Reserve(size);
  sorted_ids_.Reserve(size);
  kept_.Reserve(size);
  added_.Reserve(size);
  totals_.Reserve(kNumActions);
  const DensifyRule rule = {step.min_gradient, step.max_clone_scale, step.max_scale, step.min_opacity,
                            step.grow};
  const unsigned blocks = NumBlocks(n, kThreads);

  unsigned long long totals[kNumActions] = {};
  const auto read_totals = [&] {
    CheckCuda(cudaMemcpyAsync(totals, totals_.get(), sizeof(totals), cudaMemcpyDeviceToHost, stream),
              "totals");
    CheckCuda(cudaStreamSynchronize(stream), "densification");
  };
  const auto total = [&](DensifyAction action) {
    return static_cast<int64_t>(totals[static_cast<int>(action)]);
  };
  CheckCuda(cudaMemsetAsync(totals_.get(), 0, sizeof(totals), stream), "totals");
  DecideKernel<<<blocks, kThreads, 0, stream>>>(parameters, n, gradient_sum, view_count, rule, actions_.get(),
                                                keys_.get(), ids_.get(), totals_.get());
  CheckCuda(cudaGetLastError(), "densification");
  read_totals();

  const int64_t growing = total(DensifyAction::kClone) + total(DensifyAction::kSplit);
  const int64_t kept = total(DensifyAction::kKeep) + growing;
  int64_t room = std::numeric_limits<int32_t>::max() - kept;
  if (step.max_count > 0 && step.max_count - kept < room) room = step.max_count - kept;
  if (room < 0) room = 0;
  if (growing > room) {
    size_t bytes = 0;
    CheckCuda(cub::DeviceRadixSort::SortPairsDescending(nullptr, bytes, keys_.get(), sorted_keys_.get(),
                                                        ids_.get(), sorted_ids_.get(), n, 0, 32, stream),
              "sort by gradient");
    scratch_.Reserve(bytes);
    CheckCuda(
        cub::DeviceRadixSort::SortPairsDescending(scratch_.get(), bytes, keys_.get(), sorted_keys_.get(),
                                                  ids_.get(), sorted_ids_.get(), n, 0, 32, stream),
        "sort by gradient");
    LimitKernel<<<NumBlocks(growing - room, kThreads), kThreads, 0, stream>>>(
        parameters, static_cast<int>(room), static_cast<int>(growing), sorted_ids_.get(), rule,
        actions_.get(), totals_.get());
    CheckCuda(cudaGetLastError(), "densification");
    read_totals();
  }

  DensifyResult result;
  result.cloned = total(DensifyAction::kClone);
  result.split = total(DensifyAction::kSplit);
  result.not_finite = total(DensifyAction::kNotFinite);
  result.removed = total(DensifyAction::kRemove);
  const int64_t num_kept = count - result.removed - result.not_finite;
  result.count = num_kept + result.cloned + result.split;
  new_count_ = result.count;
  sources_.Reserve(static_cast<size_t>(new_count_));
  births_.Reserve(static_cast<size_t>(new_count_));
  FlagKernel<<<blocks, kThreads, 0, stream>>>(actions_.get(), n, kept_.get(), added_.get());
  size_t bytes = 0;
  CheckCuda(cub::DeviceScan::ExclusiveSum(nullptr, bytes, kept_.get(), kept_.get(), n, stream), "places");
  scratch_.Reserve(bytes);
  CheckCuda(cub::DeviceScan::ExclusiveSum(scratch_.get(), bytes, kept_.get(), kept_.get(), n, stream),
            "places");
  CheckCuda(cub::DeviceScan::ExclusiveSum(scratch_.get(), bytes, added_.get(), added_.get(), n, stream),
            "places");
  PlaceKernel<<<blocks, kThreads, 0, stream>>>(actions_.get(), n, kept_.get(), added_.get(),
                                               static_cast<uint32_t>(num_kept), sources_.get(),
                                               births_.get());
  CheckCuda(cudaGetLastError(), "densification");
  return result;
}

void DensifyPlan::Gather(const Planes& from, const Planes& to, cudaStream_t stream) const {
  GatherModel(sources_.get(), births_.get(), new_count_, from, to, stream);
}

void DensifyPlan::PlaceChildren(const Planes& old_parameters, const Planes& new_parameters,
                                const DensifyStep& step, cudaStream_t stream) const {
  if (new_count_ == 0) return;
  PlaceChildrenKernel<<<NumBlocks(new_count_, kThreads), kThreads, 0, stream>>>(
      sources_.get(), births_.get(), static_cast<int>(new_count_), old_parameters, new_parameters,
      step.random_seed, step.iteration);
  CheckCuda(cudaGetLastError(), "densification");
}

}  // namespace s2gs::cuda
