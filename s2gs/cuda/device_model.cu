#include <algorithm>
#include <limits>

#include "s2gs/cuda/device_model.h"
#include "s2gs/cuda/model_transfer.h"

namespace s2gs::cuda {

DeviceModel::DeviceModel(DeviceMemoryCount* memory, cudaStream_t stream)
    : memory_(memory),
      stream_(stream),
      model_(memory),
      spare_(memory),
      gradient_sum_(memory),
      view_count_(memory),
      neighbours_(memory),
      densify_(memory),
      finder_(memory) {}

void DeviceModel::SetState(const TrainState& state) {
  count_ = static_cast<int64_t>(state.gaussians.size());
  S2GS_INVARIANT(count_ <= std::numeric_limits<int32_t>::max() - 1024);
  sh_degree_ = state.gaussians.sh_degree;
  Reserve(count_);
  const auto rows = static_cast<size_t>(count_);
  UploadGaussians(state.gaussians, rows, parameters(), stream_);
  UploadGaussians(state.first_moment, rows, first_moments(), stream_);
  UploadGaussians(state.second_moment, rows, second_moments(), stream_);
  UploadSums(state.gradient_sum, gradient_sum_.get());
  UploadSums(state.view_count, view_count_.get());
  num_neighbours_ = state.num_neighbours;
  if (num_neighbours_ > 0) {
    const auto k = static_cast<size_t>(num_neighbours_);
    const auto n = static_cast<size_t>(count_);
    S2GS_INVARIANT(state.neighbours.size() == k * n);
    std::vector<uint32_t> planes(k * n);
    for (size_t i = 0; i < n; ++i) {
      for (size_t j = 0; j < k; ++j) planes[j * n + i] = state.neighbours[i * k + j];
    }
    neighbours_.Reserve(k * n);
    UploadArray(planes, neighbours_.get(), "neighbours", stream_);
    Wait();
  }
}

TrainState DeviceModel::GetState() const {
  TrainState state;
  state.gaussians = Download(parameters());
  state.first_moment = Download(first_moments());
  state.second_moment = Download(second_moments());
  state.gradient_sum = DownloadArray(gradient_sum_.get(), static_cast<size_t>(count_), stream_);
  state.view_count = DownloadArray(view_count_.get(), static_cast<size_t>(count_), stream_);
  state.num_neighbours = num_neighbours_;
  const auto k = static_cast<size_t>(num_neighbours_);
  const auto n = static_cast<size_t>(count_);
  const std::vector<uint32_t> planes = DownloadArray(neighbours_.get(), k * n, stream_);
  state.neighbours.resize(k * n);
  for (size_t i = 0; i < n; ++i) {
    for (size_t j = 0; j < k; ++j) state.neighbours[i * k + j] = planes[j * n + i];
  }
  return state;
}

Placement DeviceModel::GetPlacement() const {
  const auto n = static_cast<size_t>(count_);
  Placement placement;
  placement.centre.resize(3 * n);
  for (size_t axis = 0; axis < 3; ++axis) {
    const std::vector<float> plane = DownloadArray(model_.get() + (kCentre + axis) * stride_, n, stream_);
    for (size_t i = 0; i < n; ++i) placement.centre[3 * i + axis] = plane[i];
  }
  placement.foreground_logit = DownloadArray(model_.get() + kForeground * stride_, n, stream_);
  return placement;
}

void DeviceModel::Keep(const std::vector<uint32_t>& indices) {
  const std::vector<float> gradient_sum = Chosen(gradient_sum_.get(), indices);
  const std::vector<float> view_count = Chosen(view_count_.get(), indices);
  DeviceBuffer<uint32_t> sources(memory_);
  sources.Reserve(std::max<size_t>(1, indices.size()));
  CheckCuda(cudaMemcpyAsync(sources.get(), indices.data(), indices.size() * sizeof(uint32_t),
                            cudaMemcpyHostToDevice, stream_),
            "choice of Gaussians");
  spare_.Reserve(3 * kNumPlanes * stride_);
  GatherModel(sources.get(), nullptr, static_cast<int64_t>(indices.size()), parameters(),
              {spare_.get(), stride_}, stream_);
  Wait();
  model_.Swap(spare_);
  count_ = static_cast<int64_t>(indices.size());
  UploadSums(gradient_sum, gradient_sum_.get());
  UploadSums(view_count, view_count_.get());
  num_neighbours_ = 0;
}

DensifyResult DeviceModel::Densify(const DensifyStep& step) {
  const DensifyResult result =
      densify_.Make(parameters(), count_, gradient_sum_.get(), view_count_.get(), step, stream_);
  const auto new_count = static_cast<size_t>(result.count);
  // Children need their parents' centres, scales and rotations, so the new model is built beside the old
  // one.
  const bool is_larger = new_count > stride_;
  const size_t new_stride = is_larger ? PaddedStride(std::max(new_count, stride_ + stride_ / 2)) : stride_;
  spare_.Reserve(3 * kNumPlanes * new_stride);
  const Planes old_parameters = parameters();
  const Planes new_parameters = {spare_.get(), new_stride};
  densify_.Gather(old_parameters, new_parameters, stream_);
  densify_.PlaceChildren(old_parameters, new_parameters, step, stream_);
  Wait();
  model_.Swap(spare_);
  if (is_larger) spare_.Free();
  stride_ = new_stride;
  count_ = result.count;
  ReserveStatistics();
  ClearStatistics();
  if (num_neighbours_ > 0) RefreshNeighbours(num_neighbours_);
  return result;
}

void DeviceModel::RefreshNeighbours(int k) {
  num_neighbours_ = static_cast<int>(std::min<int64_t>(std::min(k, kMaxNeighbours), count_ - 1));
  if (num_neighbours_ <= 0) {
    num_neighbours_ = 0;
    return;
  }
  neighbours_.Reserve(static_cast<size_t>(num_neighbours_) * static_cast<size_t>(count_));
  finder_.Find(parameters().At(kCentre), stride_, count_, num_neighbours_, neighbours_.get(), stream_);
}

void DeviceModel::Reserve(int64_t count) {
  const auto size = static_cast<size_t>(count);
  if (size > stride_ || model_.get() == nullptr) {
    spare_.Free();
    model_.Free();
    stride_ = PaddedStride(std::max(size, stride_ + stride_ / 2));
    model_.Reserve(std::max<size_t>(1, 3 * kNumPlanes * stride_));
  }
  ReserveStatistics();
  ClearStatistics();
}

void DeviceModel::ReserveStatistics() {
  gradient_sum_.Reserve(stride_);
  view_count_.Reserve(stride_);
}

void DeviceModel::ClearStatistics() {
  const size_t bytes = sizeof(float) * static_cast<size_t>(count_);
  CheckCuda(cudaMemsetAsync(gradient_sum_.get(), 0, bytes, stream_), "statistics");
  CheckCuda(cudaMemsetAsync(view_count_.get(), 0, bytes, stream_), "statistics");
}

std::vector<float> DeviceModel::Chosen(const float* data, const std::vector<uint32_t>& indices) const {
  const std::vector<float> all = DownloadArray(data, static_cast<size_t>(count_), stream_);
  std::vector<float> chosen;
  chosen.reserve(indices.size());
  for (const uint32_t index : indices) chosen.push_back(all[index]);
  return chosen;
}

void DeviceModel::UploadSums(const std::vector<float>& values, float* target) const {
  if (values.empty()) return;
  S2GS_INVARIANT(values.size() == static_cast<size_t>(count_));
  UploadArray(values, target, "state", stream_);
  Wait();
}

Gaussians DeviceModel::Download(const Planes& planes) const {
  Gaussians gaussians = DownloadGaussians(planes, static_cast<size_t>(count_), stream_);
  gaussians.sh_degree = sh_degree_;
  return gaussians;
}

}  // namespace s2gs::cuda
