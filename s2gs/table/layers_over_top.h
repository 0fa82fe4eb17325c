#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "s2gs/backend/backend.h"
#include "s2gs/core/pinhole_view.h"
#include "s2gs/core/rotating_region.h"
#include "s2gs/table/photo_table.h"
#include "s2gs/table/plain_top.h"
#include "s2gs/table/textured_top.h"

namespace s2gs {

/// Depths of the rotating part alone, by pixel of a view; 0 where it is not opaque. \param backend  with the
/// model, which is left as it was.
std::vector<float> RotatingDepths(const PinholeView& view, Backend* backend);

/// The same as each photo of the stations sees it, by photo and pixel.
std::vector<std::vector<float>> RotatingDepths(const std::vector<StationPhotos>& stations, Backend* backend);

/// The numbers below `count` that are not among these, both in ascending order.
std::vector<uint32_t> AllBut(const std::vector<uint32_t>& left_out, size_t count);

/// RotatingDepths without these Gaussians, in ascending order.
using DepthsWithout = std::function<std::vector<std::vector<float>>(const std::vector<uint32_t>&)>;

/// \param backend  with the model, which it has again after each call.
DepthsWithout RotatingDepthsWithout(const std::vector<StationPhotos>& stations, Backend* backend);

/// Makes kElsewhere of shadows on the top where something stands before it: what hides the top has its
/// colours by chance. \param depths  of what is there, by pixel of the view; 0 where nothing is.
void ForgetHiddenShadows(const RotatingRegion& table, const PinholeView& view,
                         const std::vector<float>& depths, std::vector<TopSight>* sights);

/// Which sights of a top refute what stands before them.
enum class TopEvidence : uint8_t {
  kNone,   ///< None: things have the top's own colour.
  kLight,  ///< The top in its own light: things may have the colours of shadows on it.
  kColors  ///< In shadows, too.
};
bool IsTopSeen(TopSight sight, TopEvidence evidence);

struct LayersOverTop {
  std::vector<uint32_t> gaussians;  ///< in ascending order.
  /// In ascending order, what hides no shadow on the top: these, others that no photo bears out, the table's.
  std::vector<uint32_t> hides_nothing;
  TopEvidence evidence = TopEvidence::kNone;
};

/// The rotating Gaussians over the top, higher than a pixel of the photos, that photos refute: the top is
/// seen through them, in its own light more often than chance and than something else that nothing before
/// them explains; or in a shadow on it, where nothing stands before the top that would
/// stay if each shadow counted. A thing may have a
/// shadow's colour, so that shadows count, and borders next to the top in its light do not, only where hardly
/// any point of things goes for it; where points are too few to tell, hardly any Gaussian that stands too
/// high for a layer, and never where no thing is so high. None where things go for the top's own light, too.
/// \param stations  Learn's. \param depths_without  of the model with these Gaussians. \param of_things
/// points that turn for sure, as tracks through several photos do.
LayersOverTop FindLayersOverTop(const PlainTop& top, const std::vector<StationPhotos>& stations,
                                const DepthsWithout& depths_without, const Placement& gaussians,
                                const std::vector<Eigen::Vector3d>& of_things);

/// The same by a top's own texture, which photos show in more of them than chance and than another texture
/// there that nothing before them explains: a thing is not what photos agree on at the top's plane. In
/// ascending order; none where things go for it. \param depths  RotatingDepths'.
std::vector<uint32_t> FindLayersOverTexture(const TexturedTop& top,
                                            const std::vector<StationPhotos>& stations,
                                            const std::vector<std::vector<float>>& depths,
                                            const Placement& gaussians);

struct StandingOverTop {
  std::vector<uint32_t> gaussians;  ///< in ascending order.
  /// Whether what turns stays when these go: points of things would, or, where these are too few to tell,
  /// what stands too high for a layer does.
  bool spares_things = false;
};

/// The rotating Gaussians over the top, higher than a pixel, through which photos show what stands still:
/// more of them the same as most of their station do, of another tint than elsewhere, than something else
/// that nothing before them explains. \param depths  RotatingDepths'. \param of_things  points that turn for
/// sure, as tracks through several photos do.
StandingOverTop FindStandingOverTop(const RotatingRegion& table, const std::vector<StationPhotos>& stations,
                                    const std::vector<std::vector<float>>& depths, const Placement& gaussians,
                                    const std::vector<Eigen::Vector3d>& of_things);

}  // namespace s2gs
