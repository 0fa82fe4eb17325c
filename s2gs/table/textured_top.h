#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <vector>

#include "s2gs/core/pinhole_view.h"
#include "s2gs/core/rotating_region.h"
#include "s2gs/image/image_file.h"
#include "s2gs/table/photo_table.h"
#include "s2gs/table/plain_top.h"

namespace s2gs {

/// The texture of a table's top as photos agree on it, and which pixels of a photo show it: nothing stands
/// before the top there. Of each place on the plane, photos that see it show the same patch, and those that
/// see a thing before it others, each another one. Which they are is told by their agreement alone, so that
/// nothing is asked of the model.
class TexturedTop {
 public:
  /// Nothing where photos agree on no place, or one camera takes too few of them.
  /// \param table  from photos, to a pixel.
  static std::optional<TexturedTop> Learn(const std::vector<StationPhotos>& stations,
                                          const RotatingRegion& table);

  /// By pixel: kLit where the photo shows the top's texture and nothing else within two pixels, kOther where
  /// it shows another, and else kElsewhere.
  /// \param photo, view  of the size of the stations' photos.
  std::vector<TopSight> Sights(const Image8& photo, const PinholeView& view) const;
  /// One channel: 255 where the sight is kLit.
  Image8 Look(const Image8& photo, const PinholeView& view) const;

  /// Of the top beyond half its radius, which things hide least: the share of 24 cells (twelve sectors, two
  /// rings) in which photos agree on what lies on the plane. Where they do so all over, the top is the plane.
  double AgreedShare() const;

  const RotatingRegion& table() const { return table_; }

 private:
  explicit TexturedTop(const RotatingRegion& table) : table_(table) {}
  struct Witness;
  class SampledRows;

  Eigen::Vector3d PlaceAt(double column, double row) const;  // in the object's frame
  // Whether a patch about the place lies on the top.
  bool HoldsPatch(int column, int row) const;
  // Finds the patches of rows first to last.
  void LearnRows(const std::vector<Witness>& witnesses, int first, int last);

  RotatingRegion table_;
  Eigen::Vector3d along_x_ = Eigen::Vector3d::UnitX();
  Eigen::Vector3d along_y_ = Eigen::Vector3d::UnitY();
  float least_texture_ = 0;  // [grey levels]
  double spacing_ = 0;       // of places and of a patch's points
  int side_ = 0;             // places along an edge of the square about the top
  // Of each place the patch that most photos agree on, of mean 0 and length 1; empty: none.
  std::vector<std::vector<float>> patches_;
};

}  // namespace s2gs
