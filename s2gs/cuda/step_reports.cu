#include <algorithm>
#include <limits>

#include "s2gs/cuda/step_reports.h"
#include "sfm_split/base/error.h"

namespace s2gs::cuda {
namespace {

constexpr int64_t kMinRoom = 1 << 16;
constexpr double kMargin = 1.15;
// Forgets a peak over some thousands of steps.
constexpr double kDecay = 0.9998;

}  // namespace

StepReports::StepReports(DeviceMemoryCount* memory) : report_(memory) {
  report_.Reserve(1);
  CheckCuda(cudaMallocHost(&host_reports_, kStepsAhead * sizeof(StepReport)), "cudaMallocHost");
  for (cudaEvent_t& event : events_) {
    CheckCuda(cudaEventCreateWithFlags(&event, cudaEventDisableTiming), "cudaEventCreate");
  }
}

StepReports::~StepReports() {
  for (const cudaEvent_t event : events_) cudaEventDestroy(event);
  cudaFreeHost(host_reports_);
}

int64_t StepReports::Count(cudaStream_t stream) const {
  StepReport report;
  CheckCuda(cudaMemcpyAsync(&report, report_.get(), sizeof(report), cudaMemcpyDeviceToHost, stream),
            "report");
  CheckCuda(cudaStreamSynchronize(stream), "computation");
  if (report.num_intersections > static_cast<uint64_t>(std::numeric_limits<int64_t>::max() / 2)) {
    throw UserError("The view has too many pairs of a splat and a tile. Use a smaller image size");
  }
  return static_cast<int64_t>(report.num_intersections);
}

void StepReports::MakeRoom(int64_t count, TileSorter* sorter) {
  peak_ = std::max(peak_, static_cast<double>(count));
  room_ = static_cast<int64_t>(kMargin * peak_) + kMinRoom;
  if (room_ <= reserved_room_) return;
  const auto generous = std::min<int64_t>(room_ + room_ / 4, std::numeric_limits<int32_t>::max());
  reserved_room_ = std::max(room_, generous);
  sorter->ReserveIntersections(reserved_room_);
}

void StepReports::ExpectGrowth(double ratio, TileSorter* sorter) {
  if (room_ == 0) return;
  peak_ *= ratio;
  MakeRoom(0, sorter);
}

void StepReports::Forget() {
  num_read_ = num_sent_;
  peak_ = 0;
  room_ = 0;
}

void StepReports::Send(cudaStream_t stream) {
  const int slot = static_cast<int>(num_sent_ % kStepsAhead);
  CheckCuda(cudaMemcpyAsync(host_reports_ + slot, report_.get(), sizeof(StepReport), cudaMemcpyDeviceToHost,
                            stream),
            "report");
  CheckCuda(cudaEventRecord(events_[slot], stream), "report");
  ++num_sent_;
}

void StepReports::Read(TileSorter* sorter) {
  while (num_read_ < num_sent_) {
    const int slot = static_cast<int>(num_read_ % kStepsAhead);
    const bool is_full = num_sent_ - num_read_ >= kStepsAhead;
    const cudaError_t state = is_full ? cudaEventSynchronize(events_[slot]) : cudaEventQuery(events_[slot]);
    if (state == cudaErrorNotReady) return;
    CheckCuda(state, "computation");
    peak_ *= kDecay;
    if (room_ > 0) MakeRoom(static_cast<int64_t>(host_reports_[slot].num_intersections), sorter);
    ++num_read_;
  }
}

}  // namespace s2gs::cuda
