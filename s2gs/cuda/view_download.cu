#include <vector>

#include "s2gs/cuda/model_transfer.h"
#include "s2gs/cuda/view_download.h"

namespace s2gs::cuda {

RenderedView DownloadView(const RenderRequest& request, RenderChannels channels, const Maps& maps,
                          cudaStream_t stream) {
  const size_t size = static_cast<size_t>(request.view.width) * request.view.height;
  RenderedView view;
  view.width = request.view.width;
  view.height = request.view.height;
  const std::vector<float> color = DownloadArray(maps.color, 3 * size, stream);
  view.alpha = DownloadArray(maps.transmittance, size, stream);
  view.color.resize(3 * size);
  for (size_t i = 0; i < size; ++i) {
    for (size_t c = 0; c < 3; ++c) {
      view.color[3 * i + c] = color[c * size + i] + view.alpha[i] * request.background_color[c];
    }
    view.alpha[i] = 1 - view.alpha[i];
  }
  if (channels.foreground) view.foreground = DownloadArray(maps.foreground, size, stream);
  if (channels.geometry) {
    const std::vector<float> normal = DownloadArray(maps.normal, 3 * size, stream);
    const std::vector<float> weight = DownloadArray(maps.weight, size, stream);
    view.expected_depth = DownloadArray(maps.depth, size, stream);
    view.median_depth = DownloadArray(maps.median_depth, size, stream);
    view.distortion = DownloadArray(maps.distortion, size, stream);
    view.normal.resize(3 * size);
    for (size_t i = 0; i < size; ++i) {
      view.expected_depth[i] = weight[i] > 0 ? view.expected_depth[i] / weight[i] : 0.0F;
      for (size_t c = 0; c < 3; ++c) view.normal[3 * i + c] = normal[c * size + i];
    }
  }
  return view;
}

}  // namespace s2gs::cuda
