#pragma once

#include "s2gs/backend/backend.h"
#include "s2gs/cuda/device_data.h"
#include "s2gs/cuda/render.h"

namespace s2gs::cuda {

/// What was asked for of a view that was drawn. Waits for the GPU. \param maps  of the channels.
RenderedView DownloadView(const RenderRequest& request, RenderChannels channels, const Maps& maps,
                          cudaStream_t stream);

}  // namespace s2gs::cuda
