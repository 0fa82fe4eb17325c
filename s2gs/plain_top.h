#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <vector>

#include "s2gs/backend/backend.h"
#include "s2gs/core/pinhole_view.h"
#include "s2gs/core/rotating_region.h"
#include "s2gs/image/image_file.h"
#include "s2gs/photo_table.h"

namespace s2gs {

/// What a pixel shows by its colour of a table's plain top.
enum class TopSight : uint8_t {
  kElsewhere,  ///< Not the top's pixel, or nothing is known of its light.
  kOther,      ///< Another colour or texture.
  kLit,        ///< The top's own colour there.
  kShadow,     ///< The same, darker.
};

/// The plain top of a table under light that stands still: the colour that each station's camera sees where
/// nothing stands on it. No photo tells the shape of a plain surface, but where it is seen.
class PlainTop {
 public:
  /// Nothing where no station sees the top, with one smooth colour on a ring just within the rim.
  /// \param table  from photos, to a pixel; its top has no texture (TexturedShareOfTop).
  static std::optional<PlainTop> Learn(const std::vector<StationPhotos>& stations,
                                       const RotatingRegion& table);

  /// By pixel of one of a station's photos; all kElsewhere where nothing is known of the station.
  std::vector<TopSight> Look(const Image8& photo, const PinholeView& view, int station) const;

  const RotatingRegion& table() const { return table_; }

 private:
  // A photo's pixel on the top, with a patch about it.
  struct TopPixel {
    int x = 0, y = 0;
    Eigen::Vector3d x_in_world;
  };
  // Of the logarithms of the three channels.
  struct LitColor {
    int station = 0;
    Eigen::Matrix<double, 6, 3> terms = Eigen::Matrix<double, 6, 3>::Zero();  // a parabola over the top
    double deviation = 0;     // of patches in photos, which are lit, from it
    float least_texture = 0;  // [grey levels]
  };

  explicit PlainTop(const RotatingRegion& table);
  // In the world or in the object, from the axis, in radii of the table.
  Eigen::Vector2d LevelOf(const Eigen::Vector3d& x) const;
  std::vector<TopPixel> PixelsOf(const PinholeView& view) const;
  std::optional<LitColor> LearnColor(const StationPhotos& station) const;
  std::vector<Eigen::RowVector3d> ErrorsOf(const LitColor& color, const Image8& photo,
                                           const std::vector<TopPixel>& pixels) const;
  static TopSight SightOf(const LitColor& color, const Eigen::RowVector3d& error);

  RotatingRegion table_;
  RotatingRegion top_;  // the table without its side
  Eigen::Vector3d along_x_;
  Eigen::Vector3d along_y_;
  std::vector<LitColor> colors_;
};

/// Depths of the rotating part alone as each photo of the stations sees it, by photo and pixel; 0 where it is
/// not opaque. \param backend  with the model, which is left as it was.
std::vector<std::vector<float>> RotatingDepths(const std::vector<StationPhotos>& stations, Backend* backend);

/// The rotating Gaussians over the top, higher than a pixel of the photos, that photos refute: the top in its
/// own light is seen through them, more often than chance and than something else that nothing before them
/// explains. In a shadow a thing of the same colour would look the same, so that shadows say nothing.
/// \param stations  Learn's. \param depths  RotatingDepths'.
std::vector<uint32_t> FindLayersOverTop(const PlainTop& top, const std::vector<StationPhotos>& stations,
                                        const std::vector<std::vector<float>>& depths,
                                        const Placement& gaussians);

}  // namespace s2gs
