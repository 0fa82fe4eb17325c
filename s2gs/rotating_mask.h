#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "s2gs/backend/backend.h"
#include "s2gs/core/gaussians.h"
#include "s2gs/image/image_error.h"
#include "s2gs/scene/training_scene.h"
#include "s2gs/table_rim.h"

namespace s2gs {

/// Where the rotating part ends, from the Gaussians that rotate.
struct RotatingShape {
  RotatingRegion swept;              ///< within the scene's region.
  std::optional<RotatingSide> side;  ///< absent when its end, or what goes on below, is not found.
};

/// Nothing when the scene has no region. When few rotating Gaussians lie below the widest part's lower end
/// (as with a disc), that end bounds `swept`, else the scene's region does.
std::optional<RotatingShape> FindRotatingShape(const TrainingScene& scene, const Gaussians& gaussians);

/// Rotating Gaussians that a standard deviation along one of their axes leads farther from the axis than
/// anything turns: of a plain ground, about which photos do not tell whether it does. In ascending order.
std::vector<uint32_t> FindReachingOut(const RotatingRegion& region, const Gaussians& gaussians);

/// Rotating Gaussians whose centres lie in a region. In ascending order.
/// \param margin  beyond the region that is still inside.
std::vector<uint32_t> FindRotatingIn(const RotatingRegion& region, double margin, const Placement& gaussians);

/// Static Gaussians of the table's top and side count as rotating from here on, whatever their colour.
void CountTableAsRotating(const TableRim& table, RotatingShape* shape);

/// What to render for the mask of the rotating part. Static Gaussians where the rotating part sweeps are left
/// out: nothing that stands still can be there, so that they are shadows or reflections that keep their place
/// while the surface moves on below them. Static ones at the lower end of its side count as rotating when
/// they have the side's colour and stand as it does: a plain side under light that stands still looks the
/// same either way. Static ones elsewhere may stand before the rotating part and hide it. In photos of a
/// single station the depth of what stands still cannot be observed: all of it is taken to be behind.
///
/// \param shape  FindRotatingShape's of the model that is rendered.
RenderRequest MaskRequest(const TrainingScene& scene, const std::optional<RotatingShape>& shape,
                          const PinholeView& view);

/// The pixels where the map of the indicator p >= tau is above one half.
PixelMask RotatingMask(const RenderedView& view);

}  // namespace s2gs
