#pragma once

#include "s2gs/backend/backend.h"
#include "s2gs/cuda/device_data.h"
#include "s2gs/cuda/project.h"
#include "s2gs/kernel/adam.h"

namespace s2gs::cuda {

/// What a step leaves to be learnt of the colours' bands 1 to 3: nothing but colours needs it before the next
/// view is drawn. Its gradients are in the log's planes of its slot.
struct ColorUpdate {
  AdamStep<float> adam;
  float rate = 0;
  int slot = 0;
  const uint32_t* tile_counts = nullptr;  ///< those of 0 stay as they are. Null: none does.
};

/// The last steps' updates, as a kernel needs them. Classes are chunks of consecutive Gaussians in turn.
struct ColorUpdates {
  int sh_degree = 0;  ///< of all of them.
  int size = 0;
  int written = 0;                      ///< the class that is written back.
  int num_missing[kColorLogSize] = {};  ///< by class: how many of the last ones it lacks.
  ColorUpdate updates[kColorLogSize];   ///< the oldest first.
};

/// Which updates the coefficients of bands 1 to 3 and their moments in memory still lack. Colours are drawn
/// with all of them, which the steps' gradients tell; writing back is the half of an update's cost, and each
/// view does it for one class of Gaussians, with all that this class lacks.
class ColorLog {
 public:
  bool IsEmpty() const { return updates_.size == 0; }
  int sh_degree() const { return updates_.sh_degree; }
  const ColorUpdates& updates() const { return updates_; }

  /// Where the next update's gradients belong.
  int next_slot() const { return next_slot_; }
  /// \param update  of next_slot(). Those that the log has are of the same degree.
  void Add(const ColorUpdate& update, int sh_degree);
  /// After a kernel that writes back the class whose turn it is,
  void WroteOne();
  /// or all of them.
  void WroteAll();

 private:
  void Forget();

  ColorUpdates updates_;
  int next_slot_ = 0;
};

struct ColorInput {
  Planes parameters, first_moments, second_moments;
  Planes scratch;                        ///< ScratchPlane's: the log's in, kColorByDirection out.
  const uint32_t* is_skipped = nullptr;  ///< by slot of the log; 1: the update changes nothing.
  int64_t count = 0;
  int num_processors = 0;  ///< the GPU's.
};

/// Opacities and colours with all updates in `splats`, what the pass back has to know of the colours
/// (ColorTraits) and how they change with the view direction; writes one class back.
void DrawColors(const ColorInput& input, const ColorUpdates& updates, const ProjectOptions& view,
                PackedSplat* splats, uint8_t* traits, cudaStream_t stream);

/// Writes all classes back.
void LearnColors(const ColorInput& input, const ColorUpdates& updates, cudaStream_t stream);

}  // namespace s2gs::cuda
