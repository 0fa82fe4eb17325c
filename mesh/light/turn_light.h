#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "mesh/light/light_transfer.h"

namespace s2gs {

/// Brighter grey values may be clipped.
inline constexpr float kBrightestGrey = 250;
/// Of Cauchy's weights, in sigmas: with normal errors 95 % as good as least squares. (Holland and Welsch,
/// 1977)
inline constexpr double kLightCauchy = 2.385;
/// Rounding to grey values and the smoothing of photos.
inline constexpr double kLeastLightSigma = 0.5;

/// What one photo shows of a place, with its exposure taken out.
struct LitSample {
  uint32_t place = 0;
  uint16_t photo = 0;
  Eigen::Array3f color = Eigen::Array3f::Zero();  ///< sRGB, from 0 to 255.
  bool judges = true;  ///< counts where its photo judges whether there is such light.
};

/// The light of each channel in the object's frame as it stands in one photo.
using PhotoLight = Eigen::Matrix<float, kLightTerms, 3>;

/// Light that stands still while the table turns: it comes from far away and is the same in all photos, but
/// turns about the object, so that a place is lit otherwise in each photo.
class TurnLight {
 public:
  /// Even light: every shade is 1.
  TurnLight() = default;
  /// \param in_world           the harmonics of each channel.
  /// \param world_from_object  the photos' rotations: shades are beside the mean of their light.
  TurnLight(const Eigen::Matrix<double, kLightTerms, 3>& in_world,
            const std::vector<Eigen::Matrix3d>& world_from_object);

  bool is_even() const { return is_even_; }
  /// As the object sees it.
  PhotoLight Turned(const Eigen::Matrix3d& world_from_object) const;
  /// The light that a place gets as a share of its mean over the photos, in each channel; at least 1/16.
  Eigen::Array3f Shade(const PhotoLight& light, const LightTerms& transfer) const;

 private:
  bool is_even_ = true;
  Eigen::Matrix<double, kLightTerms, 3> in_world_ = Eigen::Matrix<double, kLightTerms, 3>::Zero();
  PhotoLight mean_ = PhotoLight::Zero();
};

/// Whether a table turns in photos: by more than rounding and shake.
bool Turns(const std::vector<Eigen::Matrix3d>& world_from_object);

struct LightFinding {
  TurnLight light;        ///< even where the table does not turn, or where no light explains left-out photos.
  double error_even = 0;  ///< of photos that the fit did not see, with even light [grey values, median].
  double error_lit = 0;   ///< the same under the light.
};

/// The light under which the samples of each place have one colour of their own: least squares of products
/// colour x light in turn, with Cauchy's weights in grey values. A fifth of the photos is left out first and
/// judges whether there is such light at all.
/// \param samples            places in ascending order.
/// \param transfers          of the places.
/// \param world_from_object  rotations of the photos.
/// \param num_threads        0: one for each core. The result does not depend on it.
LightFinding FitTurnLight(const std::vector<LitSample>& samples, const std::vector<LightTerms>& transfers,
                          const std::vector<Eigen::Matrix3d>& world_from_object, int num_threads = 0);

/// An sRGB colour from 0 to 255 under light so many times as strong; by a shade of 1 unchanged to the bit.
Eigen::Array3f UnderLight(const Eigen::Array3f& srgb, const Eigen::Array3f& shade);

}  // namespace s2gs
