#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <vector>

#include "s2gs/core/pinhole_view.h"
#include "s2gs/core/rotating_region.h"
#include "s2gs/image/image_file.h"
#include "s2gs/table/photo_table.h"

namespace s2gs {

/// What a pixel shows by its colour of a table's plain top.
enum class TopSight : uint8_t {
  kElsewhere,  ///< Not the top's pixel, or the photo does not tell.
  kOther,      ///< Another colour or texture, or a darkness that no shadow on the top has.
  kBorder,  ///< Texture about the top's colours, in whatever light: of a thing, or a border before the top.
  kLit,     ///< The top's own colour or texture there.
  kShadow,  ///< The same where the light is hidden, and as much of the sky as may be.
};

/// The plain top of a table under light that stands still: the colour that each station's camera sees where
/// nothing stands on it, and how much darker it is where a shadow falls, when one falls next to the rim. No
/// photo tells the shape of a plain surface, but where it is seen.
class PlainTop {
 public:
  /// Nothing where no station sees the top, with one smooth colour and no pattern on a ring just within the
  /// rim.
  /// \param table  from photos, to a pixel.
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
  // Of the logarithms of the three channels, in the unit of lit ones.
  struct ShadowColor {
    Eigen::RowVector3d umbra = Eigen::RowVector3d::Zero();  // what a shadow adds where the sky is open
    double deviation = 0;                                   // of patches' tints from it
    double darkest_lit = 0;                                 // in the light, all of the sky hidden
  };
  struct TopColor {
    int station = 0;
    Eigen::Matrix<double, 6, 3> terms = Eigen::Matrix<double, 6, 3>::Zero();  // lit, a parabola over the top
    double deviation = 0;     // of patches in photos, which are lit, from it
    float least_texture = 0;  // [grey levels]
    std::optional<ShadowColor> shadow;
  };

  explicit PlainTop(const RotatingRegion& table);
  // In the world or in the object, from the axis, in radii of the table.
  Eigen::Vector2d LevelOf(const Eigen::Vector3d& x) const;
  std::vector<TopPixel> PixelsOf(const PinholeView& view) const;
  float TextureOverGrain(const StationPhotos& station) const;
  std::optional<TopColor> LearnColor(const StationPhotos& station) const;
  double PatternOn(const TopColor& color, const StationPhotos& station) const;
  std::optional<ShadowColor> LearnShadow(const TopColor& color, const StationPhotos& station) const;
  std::vector<Eigen::RowVector3d> ErrorsOf(const TopColor& color, const Image8& photo,
                                           const std::vector<TopPixel>& pixels, int radius) const;
  static TopSight SightOf(const TopColor& color, const Eigen::RowVector3d& error);
  static bool IsOnShadeLine(const TopColor& color, const Eigen::RowVector3d& error);

  RotatingRegion table_;
  RotatingRegion top_;  // the table without its side
  Eigen::Vector3d along_x_;
  Eigen::Vector3d along_y_;
  std::vector<TopColor> colors_;
};

}  // namespace s2gs
