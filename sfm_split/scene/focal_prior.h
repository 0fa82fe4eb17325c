#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <optional>

#include "sfm_split/scene/camera_model.h"

namespace s2gs {

/// The logarithm of a focal length is normal.
struct FocalNormal {
  double focal_px = 0;
  double sigma_log = 0;  ///< standard deviation of the logarithm.
};

/// What is known of a focal length before the photos' geometry is looked at. What EXIF states may be wrong:
/// photos were cut or resized to another shape after it was written, or zoomed into by a camera that does not
/// say so. Where it is, it says nothing; of both normals the likelier counts (a max-mixture, Olson and
/// Agarwal 2013), so that a focal length far from what is stated is not drawn to it.
struct FocalPrior {
  FocalNormal likeliest;                 ///< what is stated, or what lenses have.
  std::optional<FocalNormal> otherwise;  ///< what lenses have, where `likeliest` is stated.

  /// The normal that a focal length belongs to. \param log_focal  of pixels.
  const FocalNormal& At(double log_focal) const;

  /// Whether that is what is stated; false where nothing is.
  bool IsAsStated(double log_focal) const { return otherwise && &At(log_focal) == &likeliest; }

  /// Logarithm of a focal length's density over the likeliest's.
  double LogDensity(double log_focal) const;
};

/// Focal lengths beyond belong to no lens that a turntable is photographed with; shares of the longer side.
constexpr double kLeastFocalShare = 0.3;
constexpr double kMostFocalShare = 10;

/// \param is_from_exif  the camera's focal length is what EXIF says, not a guess. Its 35 mm equivalent is a
/// whole number of millimetres, may mean the film's width or its diagonal (4 % apart for photos of 4:3), and
/// knows nothing of the focus (up to 5 %): 5 % in all. Without EXIF it is 1.2 times the longer side, from 0.5
/// (wide lenses of telephones) to 2.9 (portrait lenses) within two standard deviations; and so it is with
/// EXIF where that is wrong, one time in ten.
FocalPrior FocalPriorOf(const Camera& camera, bool is_from_exif);

/// Lenses meet the photos that cameras take in their middle to about a hundredth of the longer side; what is
/// farther off than three of these was cut from a larger photo.
constexpr double kMostLensShift = 0.03;

/// How far a camera's principal point lies from where it is expected, in longer sides of its photos.
Eigen::Vector2d PrincipalPointShift(const Camera& camera, const Eigen::Vector2d& expected_px);

/// Radial distortion k of r (1 + k r^2) is normal about what is known of it: lenses have -0.35 to 0.1.
constexpr double kDistortionSigma = 0.15;

/// Place of k among the parameters of a perspective camera; nothing when its model has none.
std::optional<size_t> DistortionPlace(const Camera& camera);

/// Logarithm of how likely a lens is before the photos are looked at, over the likeliest: by its focal length
/// and, where its model and that of the camera before have it, its radial distortion.
/// \param given  the camera as it was before any photo was looked at.
double LogPriorOfLens(const Camera& camera, const Camera& given, bool is_from_exif);

/// Whether a focal length is one that a lens may have.
bool IsPlausibleFocal(const Camera& camera, double focal_px);

}  // namespace s2gs
