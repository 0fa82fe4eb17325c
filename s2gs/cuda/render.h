#pragma once

#include <type_traits>

#include "s2gs/cuda/device_data.h"

namespace s2gs::cuda {

/// Which maps are drawn.
struct RenderChannels {
  bool geometry = false;
  bool foreground = false;
  bool distortion = false;  ///< with geometry alone.
};

/// Calls run() with an object of the Channels that are wanted.
template <typename Run>
void WithChannels(const RenderChannels& wanted, const Run& run) {
  const auto with_foreground = [&](auto foreground) {
    constexpr bool kForeground = decltype(foreground)::value;
    if (wanted.geometry && wanted.distortion) {
      run(Channels<true, kForeground, true>());
    } else if (wanted.geometry) {
      run(Channels<true, kForeground, false>());
    } else {
      run(Channels<false, kForeground>());
    }
  };
  wanted.foreground ? with_foreground(std::true_type()) : with_foreground(std::false_type());
}

struct RenderInput {
  ProjectedSplats splats;
  TileLists tiles;
  int width = 0, height = 0;
  float near_depth = 0;
};

/// \param lists  to be filled for RenderBackward(), and then there is no map of the median depth. Null
///               pointers: no pass back follows.
void RenderForward(const RenderInput& input, RenderChannels channels, const Maps& maps, const HitLists& lists,
                   cudaStream_t stream);

/// Raises peak_weights[i] to the largest weight that splat i has in any pixel.
/// \param alpha  what all of them cover of each pixel; null: not asked for.
void RenderPeakWeights(const RenderInput& input, float* peak_weights, float* alpha, cudaStream_t stream);

/// Which of `count` weights are at least `min_weight`.
void MarkSeen(const float* peak_weights, int64_t count, float min_weight, uint8_t* is_seen,
              cudaStream_t stream);

/// Adds the loss by every splat, in PackedSplat's layout, to `d_splats` and `d_normal_z`.
/// \param maps, lists  as RenderForward() left them.
void RenderBackward(const RenderInput& input, RenderChannels channels, const Maps& maps,
                    const HitLists& lists, const MapGradients& gradients, const Vec3<float>& background,
                    float* d_splats, float* d_normal_z, cudaStream_t stream);

}  // namespace s2gs::cuda
