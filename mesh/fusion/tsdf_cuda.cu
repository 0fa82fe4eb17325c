#include <cuda_runtime.h>

#include <algorithm>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "mesh/fusion/tsdf_integrate.h"
#include "s2gs/core/gpu_info.h"
#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

// Views whose place in the camera's frame is worked out together, one by each thread of a block.
constexpr int kViewGroup = kBlockVoxels;

void Check(cudaError_t error, const char* what) {
  if (error == cudaSuccess) return;
  throw UserError(std::string("The GPU failed while it was to ") + what + ": " + cudaGetErrorString(error) +
                  ". Use the CPU, or a larger voxel_size when its memory does not suffice");
}

template <typename T>
class DeviceArray {
 public:
  DeviceArray() = default;
  DeviceArray(const DeviceArray&) = delete;
  DeviceArray& operator=(const DeviceArray&) = delete;
  ~DeviceArray() { cudaFree(data_); }

  T* data() const { return data_; }

  // Grows, and then forgets its content.
  void Reserve(size_t count) {
    if (count <= capacity_) return;
    cudaFree(data_);
    data_ = nullptr;
    capacity_ = 0;
    Check(cudaMalloc(&data_, count * sizeof(T)), "allocate memory");
    capacity_ = count;
  }
  void Upload(const T* values, size_t count, size_t offset = 0) {
    Check(cudaMemcpy(data_ + offset, values, count * sizeof(T), cudaMemcpyHostToDevice), "take data");
  }

 private:
  T* data_ = nullptr;
  size_t capacity_ = 0;
};

// One block of threads for each block of voxels, one thread a voxel. Views are added in their order.
__global__ void __launch_bounds__(kBlockVoxels)
    AddViews(const int3* blocks, const TsdfViewParams* views, int num_views, TsdfVoxelParams params,
             float* sums, float* weights) {
  __shared__ float first_voxels[kViewGroup][3];
  const int3 block = blocks[blockIdx.x];
  const int voxel = static_cast<int>(threadIdx.x);
  const auto dx = static_cast<float>(voxel & 7);
  const auto dy = static_cast<float>(voxel >> 3 & 7);
  const auto dz = static_cast<float>(voxel >> 6);
  const size_t place = static_cast<size_t>(blockIdx.x) * kBlockVoxels + voxel;
  float sum = sums[place];
  float weight = weights[place];
  for (int begin = 0; begin < num_views; begin += kViewGroup) {
    const int count = min(kViewGroup, num_views - begin);
    __syncthreads();
    if (voxel < count) BlockInCamera(views[begin + voxel], block.x, block.y, block.z, first_voxels[voxel]);
    __syncthreads();
    for (int i = 0; i < count; ++i) {
      const TsdfViewParams& view = views[begin + i];
      const float* first = first_voxels[i];
      float x[3];
      for (int axis = 0; axis < 3; ++axis) {
        const double* row = view.rotation + 3 * axis;
        x[axis] = first[axis] + static_cast<float>(row[0]) * dx + static_cast<float>(row[1]) * dy +
                  static_cast<float>(row[2]) * dz;
      }
      const int index = PlaneIndex(view, x[0], x[1], x[2]);
      const float4 plane = __ldg(reinterpret_cast<const float4*>(view.planes + index));
      if (plane.w == 0.0F) continue;
      float distance = 0;
      float added = 0;
      SamplePlane(params, view.focal, plane.x, plane.y, plane.z, plane.w, x[0], x[1], x[2], &distance,
                  &added);
      sum += added * distance;
      weight += added;
    }
  }
  sums[place] = sum;
  weights[place] = weight;
}

__global__ void Divide(float* sums, const float* weights, size_t count) {
  const size_t i = static_cast<size_t>(blockIdx.x) * blockDim.x + threadIdx.x;
  if (i < count && weights[i] > 0) sums[i] /= weights[i];
}

class CudaIntegrator : public TsdfIntegrator {
 public:
  CudaIntegrator(std::string device, TsdfVolume* volume) : device_(std::move(device)), volume_(*volume) {
    std::vector<int3> blocks;
    blocks.reserve(volume_.blocks.size());
    for (int b = 0; b < volume_.blocks.size(); ++b) {
      const Eigen::Vector3i block = volume_.blocks.Block(b);
      blocks.push_back(make_int3(block.x(), block.y(), block.z()));
    }
    blocks_.Reserve(blocks.size());
    blocks_.Upload(blocks.data(), blocks.size());
    const size_t num_voxels = volume_.distances.size();
    sums_.Reserve(num_voxels);
    weights_.Reserve(num_voxels);
    Check(cudaMemset(sums_.data(), 0, num_voxels * sizeof(float)), "clear memory");
    Check(cudaMemset(weights_.data(), 0, num_voxels * sizeof(float)), "clear memory");
  }

  TsdfBackend backend() const override { return TsdfBackend::kCuda; }
  std::string device() const override { return device_; }

  void Add(const std::vector<const TsdfView*>& views, const TsdfVoxelParams& params) override {
    size_t free_bytes = 0;
    size_t total_bytes = 0;
    Check(cudaMemGetInfo(&free_bytes, &total_bytes), "report its memory");
    const size_t max_planes = std::max<size_t>(planes_capacity_, free_bytes / 2 / sizeof(PixelPlane));
    for (size_t begin = 0; begin < views.size();) {
      size_t end = begin;
      size_t num_planes = 0;
      while (end < views.size() && (end == begin || num_planes + views[end]->planes.size() <= max_planes)) {
        num_planes += views[end++]->planes.size();
      }
      AddSome(views, begin, end, num_planes, params);
      begin = end;
    }
  }

  void Finish() override {
    constexpr unsigned kThreads = 256;
    const size_t count = volume_.distances.size();
    if (count == 0) return;
    Divide<<<static_cast<unsigned>((count + kThreads - 1) / kThreads), kThreads>>>(sums_.data(),
                                                                                   weights_.data(), count);
    Check(cudaGetLastError(), "divide");
    Check(cudaMemcpy(volume_.distances.data(), sums_.data(), count * sizeof(float), cudaMemcpyDeviceToHost),
          "return distances");
    Check(cudaMemcpy(volume_.weights.data(), weights_.data(), count * sizeof(float), cudaMemcpyDeviceToHost),
          "return weights");
  }

 private:
  void AddSome(const std::vector<const TsdfView*>& views, size_t begin, size_t end, size_t num_planes,
               const TsdfVoxelParams& params) {
    planes_.Reserve(num_planes);
    planes_capacity_ = std::max(planes_capacity_, num_planes);
    std::vector<TsdfViewParams> view_params;
    view_params.reserve(end - begin);
    size_t offset = 0;
    for (size_t i = begin; i < end; ++i) {
      const TsdfView& view = *views[i];
      planes_.Upload(view.planes.data(), view.planes.size(), offset);
      view_params.push_back(ViewParams(view, volume_.origin, volume_.voxel_size));
      view_params.back().planes = planes_.data() + offset;
      offset += view.planes.size();
    }
    view_params_.Reserve(view_params.size());
    view_params_.Upload(view_params.data(), view_params.size());
    const int num_blocks = volume_.blocks.size();
    if (num_blocks == 0) return;
    AddViews<<<static_cast<unsigned>(num_blocks), kBlockVoxels>>>(blocks_.data(), view_params_.data(),
                                                                  static_cast<int>(view_params.size()),
                                                                  params, sums_.data(), weights_.data());
    Check(cudaGetLastError(), "fuse");
    Check(cudaDeviceSynchronize(), "fuse");
  }

  std::string device_;
  TsdfVolume& volume_;
  DeviceArray<int3> blocks_;
  DeviceArray<float> sums_;
  DeviceArray<float> weights_;
  DeviceArray<PixelPlane> planes_;
  DeviceArray<TsdfViewParams> view_params_;
  size_t planes_capacity_ = 0;
};

}  // namespace

std::unique_ptr<TsdfIntegrator> MakeCudaIntegrator(TsdfVolume* volume) {
  for (const GpuInfo& gpu : ListGpus()) {
    if (!gpu.is_usable) continue;
    Check(cudaSetDevice(gpu.index), "start");
    return std::make_unique<CudaIntegrator>(gpu.name, volume);
  }
  return nullptr;
}

}  // namespace s2gs
