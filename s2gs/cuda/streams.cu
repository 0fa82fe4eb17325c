#include "s2gs/core/cuda.h"
#include "s2gs/cuda/streams.h"

namespace s2gs::cuda {

Streams::Streams() {
  int least_priority = 0, greatest_priority = 0;
  CheckCuda(cudaDeviceGetStreamPriorityRange(&least_priority, &greatest_priority), "stream priorities");
  CheckCuda(cudaStreamCreateWithPriority(&main_, cudaStreamNonBlocking, greatest_priority), "streams");
  CheckCuda(cudaStreamCreateWithPriority(&side_, cudaStreamNonBlocking, least_priority), "streams");
  for (cudaEvent_t* event : {&step_begins, &colors_drawn, &maps_drawn, &maps_judged, &model_judged}) {
    CheckCuda(cudaEventCreateWithFlags(event, cudaEventDisableTiming), "events");
  }
}

Streams::~Streams() {
  for (const cudaEvent_t event : {step_begins, colors_drawn, maps_drawn, maps_judged, model_judged}) {
    cudaEventDestroy(event);
  }
  cudaStreamDestroy(side_);
  cudaStreamDestroy(main_);
}

void Streams::Synchronize() const {
  cudaStreamSynchronize(side_);
  cudaStreamSynchronize(main_);
}

void Streams::HandOver(cudaStream_t from, cudaEvent_t event, cudaStream_t to) {
  CheckCuda(cudaEventRecord(event, from), "streams");
  CheckCuda(cudaStreamWaitEvent(to, event), "streams");
}

}  // namespace s2gs::cuda
