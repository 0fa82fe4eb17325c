#include "s2gs/cuda/view_maps.h"

namespace s2gs::cuda {

ViewMaps::ViewMaps(DeviceMemoryCount* memory)
    : color_(memory),
      foreground_(memory),
      geometry_(memory),
      partials_(memory),
      d_color_(memory),
      d_foreground_(memory),
      d_geometry_(memory) {}

Maps ViewMaps::Reserve(int width, int height, RenderChannels channels) {
  const size_t size = static_cast<size_t>(width) * height;
  color_.Reserve(4 * size);
  Maps maps{};
  maps.color = color_.get();
  maps.transmittance = color_.get() + 3 * size;
  if (channels.foreground) {
    foreground_.Reserve(size);
    maps.foreground = foreground_.get();
  }
  if (channels.geometry) {
    geometry_.Reserve(9 * size);
    maps.depth = geometry_.get();
    maps.normal = geometry_.get() + size;
    maps.median_depth = geometry_.get() + 4 * size;
    maps.weight = geometry_.get() + 5 * size;
  }
  if (channels.distortion) {
    maps.distortion = geometry_.get() + 6 * size;
    maps.m1 = geometry_.get() + 7 * size;
    maps.m2 = geometry_.get() + 8 * size;
  }
  return maps;
}

MapGradients ViewMaps::ReserveGradients(int width, int height, RenderChannels channels) {
  const size_t size = static_cast<size_t>(width) * height;
  partials_.Reserve(9 * size);
  d_color_.Reserve(3 * size);
  MapGradients d_maps{};
  d_maps.color = d_color_.get();
  if (channels.foreground) {
    d_foreground_.Reserve(size);
    d_maps.foreground = d_foreground_.get();
  }
  if (channels.geometry) {
    d_geometry_.Reserve(6 * size);
    d_maps.alpha = d_geometry_.get();
    d_maps.normal = d_geometry_.get() + size;
    d_maps.expected_depth = d_geometry_.get() + 4 * size;
    d_maps.distortion = d_geometry_.get() + 5 * size;
  }
  return d_maps;
}

}  // namespace s2gs::cuda
