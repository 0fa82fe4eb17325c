#pragma once

#include <cstdint>
#include <vector>

#include "sfm_split/split/station_pictures.h"

namespace s2gs {

/// How much a photo differs from what its station shows in most photos, in units of the noise.
struct ChangeMap {
  /// Deviations of one standard deviation of noise are this many grey levels; more than 15 are 255.
  static constexpr int kLevelsPerSigma = 16;
  /// A pixel of more standard deviations has changed: over 3 x 3 pixels (root mean square), by chance one in
  /// a billion.
  static constexpr int kChangedSigmas = 4;

  int width = 0;  ///< of the picture [px].
  int height = 0;
  std::vector<uint8_t> deviation;  ///< height * width; empty when the station has too few photos.
  /// height * width, 1 where a patch of 5 x 5 pixels shows what the station shows in most photos, but for a
  /// factor, as it does in a shadow; empty unless asked for.
  std::vector<uint8_t> is_shade;
};

/// What FindChanges() is asked for. kSilhouettes: shades as well; and what stands still is the mean of the
/// densest third of a pixel's values, not their median, since a thing that turns may hide more than half of
/// it.
enum class ChangeDetail { kNone, kSilhouettes };

/// What changes in front of one camera while the table turns.
struct StationChanges {
  /// height * width of the first photo's picture, 1 where photos change again and again, closed and without
  /// holes; empty when the station has too few photos to tell.
  std::vector<uint8_t> is_active;
  double active_share = 0;  ///< of the picture.
  /// height * width, 1 where more than half of the photos change close by, without holes: the table turns
  /// from photo to photo. Empty when the station has too few photos to tell.
  std::vector<uint8_t> is_busy;
};

struct SceneChanges {
  std::vector<ChangeMap> photos;         ///< per photo.
  std::vector<StationChanges> stations;  ///< per station.

  /// Of the pictures of stations that tell, the median; 0 when none does.
  double MedianActiveShare() const;
};

/// Compares every photo with what its station shows in most (the median), after shake and exposure have been
/// taken off. Noise is measured in the same residuals, so that it needs no bound of its own.
SceneChanges FindChanges(const std::vector<GreyPicture>& pictures, const PictureStations& stations,
                         ChangeDetail detail = ChangeDetail::kNone);

/// A photo's place [px] is one where most photos of its station change, or the station does not tell.
bool IsBusy(const GreyPicture& picture, const Eigen::Matrix3d& photo_from_first,
            const StationChanges& changes, const Eigen::Vector2f& xy);

/// The station's active part as a photo of it shows it: photo_size.y * photo_size.x, 1 where it changes.
/// Empty when that is not known.
std::vector<uint8_t> ActivePart(const GreyPicture& picture, const Eigen::Matrix3d& photo_from_first,
                                const StationChanges& changes);

}  // namespace s2gs
