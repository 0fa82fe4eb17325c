#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace s2gs {

/// COLMAP's camera models by their file ids, up to COLMAP 4.2.
enum class CameraModelId : int {
  kSimplePinhole = 0,
  kPinhole = 1,
  kSimpleRadial = 2,
  kRadial = 3,
  kOpenCV = 4,
  kOpenCVFisheye = 5,
  kFullOpenCV = 6,
  kFov = 7,
  kSimpleRadialFisheye = 8,
  kRadialFisheye = 9,
  kThinPrismFisheye = 10,
  kRadTanThinPrismFisheye = 11,
  kSimpleDivision = 12,
  kDivision = 13,
  kSimpleFisheye = 14,
  kFisheye = 15,
  kEucm = 16,
  kEquirectangular = 17,
};

/// Intrinsics of one camera, with COLMAP's models, parameter order and pixel convention: the centre of the
/// top-left pixel is (0.5, 0.5).
struct Camera {
  uint32_t camera_id = 0;
  CameraModelId model = CameraModelId::kPinhole;
  uint64_t width = 0;          ///< [px]
  uint64_t height = 0;         ///< [px]
  std::vector<double> params;  ///< as many as the model has, lengths in pixels.
};

/// What COLMAP's files need to know of a camera model. Parameters come in the order focal lengths, principal
/// point, the rest.
struct CameraModelInfo {
  CameraModelId id;
  std::string_view name;         ///< as in cameras.txt, e.g. "SIMPLE_RADIAL".
  std::string_view param_names;  ///< e.g. "f, cx, cy, k".
  size_t num_focal_params;       ///< 1: one for both axes; 0: the model has none (EQUIRECTANGULAR).
  size_t num_principal_point_params;
  size_t num_extra_params;
  bool has_projection;  ///< whether ProjectToImage and UnprojectFromImage know it.

  size_t NumParams() const { return num_focal_params + num_principal_point_params + num_extra_params; }
  /// Index of the first parameter after focal lengths and principal point.
  size_t FirstExtraParam() const { return num_focal_params + num_principal_point_params; }
};

/// \return  null when COLMAP has no such model.
const CameraModelInfo* FindCameraModel(int id);
const CameraModelInfo* FindCameraModel(std::string_view name);

/// Info of a model that is known to exist.
const CameraModelInfo& InfoOf(CameraModelId id);

/// (fx, fy) and (cx, cy) [px]. The model must have them: every model but EQUIRECTANGULAR.
Eigen::Vector2d FocalLengths(const Camera& camera);
Eigen::Vector2d PrincipalPoint(const Camera& camera);

/// Whether the camera images exactly as a pinhole with its focal lengths and principal point. A fisheye model
/// never does, not even with all its parameters zero, because r = f * theta is not r = f * tan(theta).
bool IsDistortionFree(const Camera& camera);

/// Throws UserError, which lists the supported models and how to get there, unless the camera's model can be
/// projected here.
/// \param path  the file that the camera comes from, for the message.
void RequireProjection(const Camera& camera, const std::filesystem::path& path);

/// Projects a point to pixels.
/// \return  nothing for points on or behind the camera plane, and for points beyond the radius at which the
/// lens polynomial turns back (they would land on pixels that see something else).
/// Throws UserError when the model cannot be projected here (RequireProjection).
std::optional<Eigen::Vector2d> ProjectToImage(const Camera& camera, const Eigen::Vector3d& x_in_cam);

/// The ray, with z = 1, that a pixel sees: the inverse of ProjectToImage to rounding.
/// \return  nothing for pixels that no point in front of the camera projects to.
/// Throws UserError when the model cannot be projected here (RequireProjection).
std::optional<Eigen::Vector3d> UnprojectFromImage(const Camera& camera, const Eigen::Vector2d& xy);

}  // namespace s2gs
