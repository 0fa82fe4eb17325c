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
  kOther,   ///< Another colour, texture, a light's border, or not the top's pixel.
  kLit,     ///< The top's own colour there.
  kShadow,  ///< The same, darker.
};

/// The plain top of a table under light that stands still: the colour that each station's camera sees where
/// nothing stands on it, and where on the table most photos see it so. There nothing stands, whatever a model
/// has built: no photo tells the shape of a plain surface, but that it is seen.
class PlainTop {
 public:
  /// Nothing where no station's ring just within the rim has a smooth colour.
  /// \param table  from photos, to a pixel; its top has no texture (TexturedShareOfTop).
  static std::optional<PlainTop> Learn(const std::vector<StationPhotos>& stations,
                                       const RotatingRegion& table);

  /// By pixel of a station's photo in the size of StationView. All kOther where nothing is known of the
  /// station.
  std::vector<TopSight> Look(const Image8& photo, const PinholeView& view, int station) const;

  /// Whether most photos see the top itself at the place above or below which a point is. In the object's
  /// frame.
  bool IsBare(const Eigen::Vector3d& x_in_object) const;

  /// Of the top that photos look at, by area.
  double BareShare() const;

  const RotatingRegion& table() const { return table_; }

 private:
  // Of the logarithms of the three channels, over the top by kTerms.
  struct LitColor {
    int station = 0;
    Eigen::Matrix<double, 6, 3> terms = Eigen::Matrix<double, 6, 3>::Zero();
    double deviation = 0;  // of a smooth surface's pixels from it.
    float least_texture = 0;
    float noise = 0;  // of a pixel [grey levels]
  };

  // In the world or in the object, from the axis, in radii of the table.
  Eigen::Vector2d LevelOf(const Eigen::Vector3d& x) const;
  explicit PlainTop(const RotatingRegion& table);
  std::optional<LitColor> LearnColor(const StationPhotos& station) const;
  static TopSight SightOf(const LitColor& color, const Eigen::RowVector3d& lit,
                          const Eigen::RowVector3d& error);
  void CountBare(const StationPhotos& station);
  std::optional<size_t> CellOf(const Eigen::Vector3d& x_in_object) const;

  RotatingRegion table_;
  RotatingRegion top_;  // the table without its side
  Eigen::Vector3d along_x_;
  Eigen::Vector3d along_y_;
  std::vector<LitColor> colors_;
  std::vector<int> lit_;     // by cell: pixels of photos that show it
  std::vector<int> looked_;  // and those that look there
};

/// Draws the top into the depths, normals and opacity of what was rendered from a view, where the photo has
/// its colour and what was rendered stands over a bare place, lower than an object would be.
/// \param sights  Look's, of this view in the size of StationView.
void DrawPlainTop(const PlainTop& top, const std::vector<TopSight>& sights, const PinholeView& view,
                  RenderedView* rendered);

}  // namespace s2gs
