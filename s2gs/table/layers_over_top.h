#pragma once

#include <cstdint>
#include <vector>

#include "s2gs/backend/backend.h"
#include "s2gs/table/photo_table.h"
#include "s2gs/table/plain_top.h"

namespace s2gs {

/// Depths of the rotating part alone as each photo of the stations sees it, by photo and pixel; 0 where it is
/// not opaque. \param backend  with the model, which is left as it was.
std::vector<std::vector<float>> RotatingDepths(const std::vector<StationPhotos>& stations, Backend* backend);

/// Which sights of a top refute what stands before them.
enum class TopEvidence : uint8_t {
  kNone,   ///< None: things have the top's own colour.
  kLight,  ///< The top in its own light: things may have the colours of shadows on it.
  kColors  ///< In shadows, too.
};
bool IsTopSeen(TopSight sight, TopEvidence evidence);

struct LayersOverTop {
  std::vector<uint32_t> gaussians;  ///< in ascending order.
  TopEvidence evidence = TopEvidence::kNone;
};

/// The rotating Gaussians over the top, higher than a pixel of the photos, that photos refute: the top is
/// seen through them, in its own light more often than chance and than something else that nothing before
/// them explains; or in a shadow on it. A thing may have a shadow's colour, so that shadows count, and
/// borders next to the top's colours do not, only where hardly any Gaussian goes for it that stands too high
/// for a layer; never where no thing is so high. None where things go for the top's own light, too. \param
/// stations  Learn's. \param depths  RotatingDepths'.
LayersOverTop FindLayersOverTop(const PlainTop& top, const std::vector<StationPhotos>& stations,
                                const std::vector<std::vector<float>>& depths, const Placement& gaussians);

/// The rotating Gaussians over the top, higher than a pixel, through which photos show what stands still:
/// more of them the same as most of their station do, of another tint than elsewhere, than something else
/// that nothing before them explains. None where as many of what stands too high for a layer would go. \param
/// depths  RotatingDepths'.
std::vector<uint32_t> FindStandingOverTop(const RotatingRegion& table,
                                          const std::vector<StationPhotos>& stations,
                                          const std::vector<std::vector<float>>& depths,
                                          const Placement& gaussians);

}  // namespace s2gs
