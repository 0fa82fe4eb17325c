#pragma once

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <functional>
#include <optional>
#include <vector>

#include "s2gs/backend/backend.h"
#include "s2gs/core/rotating_region.h"
#include "s2gs/image/image_file.h"
#include "s2gs/scene/training_scene.h"
#include "s2gs/table/photo_table.h"
#include "s2gs/table/plain_top.h"

namespace s2gs {

// Photos, a camera on a tripod looking down, of a round table that turns about the z axis above tiled ground
// that stands still. On the middle of its top lies a card, and beside it a leaf hangs down and turns with it.
constexpr int kTablePhotos = 12;  // of a turn, where a test does not ask for more.
constexpr int kTablePhotoWidth = 240;
constexpr int kTablePhotoHeight = 180;
constexpr double kTableTop = 0.1;
constexpr double kTableBottom = -0.15;
constexpr double kTableRadius = 1;
constexpr double kTablePixel = 5.0 / 200;  // at the camera's distance
constexpr double kTableLeafAt = 1.25;      // from the axis
constexpr double kCardHalfSide = 0.25;

enum class TopLook : uint8_t {
  kPlain,     ///< the card is tiled.
  kTiled,     ///< as the card is.
  kGreyCard,  ///< the card is plain, too, and darker.
};

/// Its top and its side.
inline RotatingRegion TableRegion() { return {TurntableAxis(), kTableRadius, kTableBottom, kTableTop}; }

/// \param num_photos  of one station, over a full turn. \param shake  how far its camera turns from photo to
/// photo, about its own place [rad]; as far in the first photo as in any.
TrainingScene TableOnGround(int num_photos, TopLook top, double shake = 0);
std::vector<StationPhotos> LoadStations(const TrainingScene& scene);

/// Photos of a table whose top is plain but for what its parameter says, and what they tell of it.
class PlainTableTest : public testing::TestWithParam<TopLook> {
 protected:
  PlainTableTest() : scene(TableOnGround(kTablePhotos, GetParam())), stations(LoadStations(scene)) {
    top = PlainTop::Learn(stations, TableRegion());
  }

  TrainingScene scene;
  std::vector<StationPhotos> stations;
  std::optional<PlainTop> top;
};

/// The pixels in which a view shows the table's top, as if nothing stood there: column, row, and x and y of
/// its place. \param frame_from_cam  of the frame in which that is, the world's or the object's.
void ForTopPixels(const PinholeView& view, const Rigid3& frame_from_cam,
                  const std::function<void(int, int, const Eigen::Vector2d&)>& work);

/// A photo where light is so much weaker, by channel, where it falls on these places of the top's plane,
/// which the photo shows as if nothing stood there. \param is_shaded  of x and y in the world.
Image8 ShadeTop(Image8 photo, const PinholeView& view,
                const std::function<bool(const Eigen::Vector2d&)>& is_shaded,
                const std::array<double, 3>& factors);

/// Speckles the top within .85 radii, one tile in three, with what turns or anew in each photo.
void SpeckleTop(bool is_turning, TrainingScene* scene);

/// Depths by photo and pixel: nothing is there, or the same everywhere.
std::vector<std::vector<float>> NothingHides();
std::vector<std::vector<float>> AllAt(float depth);

/// \param logit  of the probability that it rotates.
void AddGaussian(const Eigen::Vector3d& x, float logit, Placement* gaussians);

}  // namespace s2gs
