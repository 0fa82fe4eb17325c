#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "s2gs/backend/backend.h"
#include "s2gs/image/image_file.h"
#include "s2gs/scene/training_scene.h"

namespace s2gs {

/// What a pixel of a photo shows of what stands behind the rotating part.
enum class PixelSight : uint8_t {
  kNeverFree,   ///< no photo shows the background there.
  kAlike,       ///< it looks no different, but is plain: a plain thing may be before it.
  kBackground,  ///< the background's own texture: nothing that turns is there.
  kOther,       ///< not the background.
};

/// How many photos show something else than the background at a place, and how many the background.
struct SightVotes {
  int other = 0;
  int background = 0;

  /// Whether so many more show the background as chance does once in a thousand (sign test); so never with
  /// fewer than ten photos.
  bool IsStanding() const;
};

/// What turns hides the background, and shows it again as it goes on. From photos of a camera that does not
/// move, or only turns, as on a tripod that is touched: where the rotating part leaves a pixel free in some
/// of them, these show what stands behind it, and any other photo in which the same texture is seen there has
/// nothing before it that turns, whatever a model says. Plain backgrounds tell nothing, since a plain thing
/// before them looks the same.
class TurnEvidence {
 public:
  /// From the photos that are not held out. Cameras that took fewer than ten from one place say nothing.
  explicit TurnEvidence(const TrainingScene& scene);

  /// Whether any camera stood still long enough.
  bool IsAvailable() const { return !views_.empty(); }
  int num_cameras() const { return static_cast<int>(cameras_.size()); }
  /// Of the photos that count, camera by camera, reduced in size.
  const std::vector<PinholeView>& views() const { return views_; }

  /// What each pixel of each view shows, rows from top to bottom.
  /// \param covered  by view: 1 where the rotating part may hide the background, else 0.
  std::vector<std::vector<PixelSight>> Look(const std::vector<std::vector<uint8_t>>& covered) const;

 private:
  // The pictures from `first` to before `end` are one camera's.
  struct Camera {
    size_t first = 0, end = 0;
    float noise = 0;      // of a grey level.
    float tolerance = 0;  // of the most different channel of two pictures, with light that drifts.
  };

  Image8 Background(const Camera& camera, const std::vector<std::vector<uint8_t>>& covered,
                    std::vector<uint8_t>* is_seen) const;
  static std::vector<PixelSight> Compare(const Camera& camera, const Image8& picture,
                                         const Image8& background, const std::vector<uint8_t>& behind,
                                         const std::vector<uint8_t>& is_seen);

  std::vector<PinholeView> views_;
  std::vector<Image8> pictures_;                  // RGB
  std::vector<std::vector<uint8_t>> is_outside_;  // by picture and pixel: not in the photo
  std::vector<Camera> cameras_;
};

/// What the photos tell of the pixels that the rotating part covers, as shares of them that add up to 1.
struct SightShares {
  int num_cameras = 0;  ///< that stood still. 0: nothing is told, and the shares are 0.
  int num_photos = 0;
  double other = 0;       ///< something else than the background is there: they are not its.
  double background = 0;  ///< they are the background's, against the model.
  double alike = 0;       ///< cannot be told from a plain background.
  double never_free = 0;  ///< nothing to compare them with: the model alone says whose they are.
};

/// Of the backend's model, which is left as it was. Nothing when the backend cannot tell.
std::optional<SightShares> MeasureSights(const TurnEvidence& evidence, Backend* backend);

/// Which Gaussians of the rotating part the photos show to be background: those where the photos that see
/// them and their nearest neighbours vote so. The backend's model is the one to be judged; it is left as it
/// was. Empty when the evidence is not available, or the backend cannot tell what is visible.
std::vector<uint32_t> FindStandingGaussians(const TurnEvidence& evidence, Backend* backend);

}  // namespace s2gs
