#pragma once

#include <functional>
#include <optional>
#include <vector>

#include "s2gs/backend/backend.h"
#include "s2gs/core/pinhole_view.h"
#include "s2gs/image/image_file.h"
#include "s2gs/rotating_mask.h"
#include "s2gs/scene/training_scene.h"
#include "s2gs/table/table_circle.h"
#include "s2gs/table_rim.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

using LoadPhoto = std::function<Image8(const ScenePhoto&)>;

/// What one station's camera sees: some of its photos, evenly chosen, of one size and reduced. Where it has
/// turned, as a tripod that shakes does, they are turned back to how the first looks.
struct StationPhotos {
  int number = 0;                  ///< ScenePhoto's station
  std::vector<PinholeView> views;  ///< of the images' size.
  std::vector<Image8> images;      ///< RGB
  Image8 still;                    ///< MedianPicture's; as the first view sees it.
};

/// A photo's view as StationPhotos have it.
PinholeView StationView(const ScenePhoto& photo);

/// What a pixel of the stations' photos is at the axis, of the coarsest.
double PixelAtAxis(const std::vector<StationPhotos>& stations, const TurntableAxis& axis);

/// Of the stations with photos enough for a median without the object. Nothing where nothing turns.
/// Throws what `load` throws, and Interrupted. \param load  a photo without distortion, of its view's size.
std::vector<StationPhotos> LoadStationPhotos(const TrainingScene& scene, const LoadPhoto& load,
                                             Reporter& reporter);

/// The table's top from what stays the same in most photos of each station (table_circle.h), about where the
/// rotating part begins. Nothing where there are no stations, or no rim is found.
std::optional<TableCircle> FindTableInPhotos(const TrainingScene& scene,
                                             const std::vector<StationPhotos>& stations);

/// The same as masks need it. \param shape, backend  of the model, which is left as it was: what it takes to
/// stand still of the top as photos show it.
TableRim RimOfCircle(const TrainingScene& scene, const TableCircle& circle,
                     const std::optional<RotatingShape>& shape, Backend* backend);

/// Of the top's pixels: those that show more texture than noise in most photos of their station. Shadows have
/// soft borders, which do not count, and what stands on the top moves on. 1 where no photo shows the top.
double TexturedShareOfTop(const std::vector<StationPhotos>& stations, const RotatingRegion& table);

/// Which rotating Gaussians around the table stand still by the photos. Lower than its top those where no
/// more photos than not show a change, but for shadows: next to a table training lets plain ground and
/// shadows turn; what hangs down from the table changes the photos as it turns. Higher, where a thing may
/// reach beyond the rim, those where more photos show the same texture than a change: what is plain and round
/// looks alike as it turns. Where things are known and none of them reaches so far, these as the lower ones.
/// \param table  from photos, to a pixel. \param of_things  points that turn for sure.
std::vector<uint32_t> FindStandingAroundTable(const std::vector<StationPhotos>& stations,
                                              const RotatingRegion& table, const Placement& gaussians,
                                              const std::vector<Eigen::Vector3d>& of_things);

}  // namespace s2gs
