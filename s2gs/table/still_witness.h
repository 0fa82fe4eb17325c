#pragma once

#include <Eigen/Core>
#include <functional>
#include <optional>
#include <vector>

#include "s2gs/core/rotating_region.h"
#include "s2gs/image/picture_noise.h"
#include "s2gs/table/opaque_region.h"
#include "s2gs/table/photo_table.h"

namespace s2gs {

/// What one photo shows where a point would be if it turned.
struct StillSight {
  Eigen::Vector2d pixel;
  double depth = 0;          ///< of the point, in the camera.
  bool is_same = false;      ///< as most photos of the station do, as far as noise tells.
  bool is_shade = false;     ///< not so, but of that colour in less light.
  bool has_texture = false;  ///< in what most show.
  Eigen::Vector3d color;     ///< RGB [grey values]
  float tolerance = 0;       ///< of a colour, from the photos' noise.
};

/// A station's photos as witnesses of what stands still. Keeps a reference to them.
class StillWitness {
 public:
  /// \param table  hides what is behind it.
  StillWitness(const StationPhotos& station, const RotatingRegion& table);

  size_t NumPhotos() const { return station_.views.size(); }
  /// Nothing where the photo does not show the point's place, or the camera was moved since the first photo.
  std::optional<StillSight> Look(size_t photo, const Eigen::Vector3d& x_in_object) const;

 private:
  bool HasTexture(int x, int y) const;
  double MovedBy(const PinholeView& view, const Eigen::Vector3d& in_camera,
                 const Eigen::Vector2d& pixel) const;

  const StationPhotos& station_;
  PictureNoise noise_;
  float least_texture_;
  std::vector<RegionView> tables_;  // by photo
};

/// Photos that see a point's place, if it turned.
struct StillVotes {
  int changes = 0;  ///< that show something else than most of their station do.
  int same = 0;     ///< that show the same.
  int shades = 0;   ///< of the changes those that show the same in less light.
  /// Of the same those with another tint than the point has in most of them: what turns keeps its tint, in
  /// whatever light, and a plain round thing looks alike as it turns.
  int tinted = 0;
  int told = 0;  ///< of the same those that are so, or have texture.
};

/// \param is_hidden  of (witness, photo, pixel, depth): whether something is known to be before the point.
StillVotes AskWitnesses(const std::vector<StillWitness>& witnesses, const Eigen::Vector3d& x_in_object,
                        const std::function<bool(size_t, size_t, const Eigen::Vector2d&, double)>& is_hidden);

}  // namespace s2gs
