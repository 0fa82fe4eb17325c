#include "sfm_split/scene/camera_model.h"

#include <array>
#include <cmath>

#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

using Id = CameraModelId;

// In the order of COLMAP's ids.
constexpr std::array<CameraModelInfo, 18> kModels = {{
    {Id::kSimplePinhole, "SIMPLE_PINHOLE", "f, cx, cy", 1, 2, 0, true},
    {Id::kPinhole, "PINHOLE", "fx, fy, cx, cy", 2, 2, 0, true},
    {Id::kSimpleRadial, "SIMPLE_RADIAL", "f, cx, cy, k", 1, 2, 1, true},
    {Id::kRadial, "RADIAL", "f, cx, cy, k1, k2", 1, 2, 2, true},
    {Id::kOpenCV, "OPENCV", "fx, fy, cx, cy, k1, k2, p1, p2", 2, 2, 4, true},
    {Id::kOpenCVFisheye, "OPENCV_FISHEYE", "fx, fy, cx, cy, k1, k2, k3, k4", 2, 2, 4, true},
    {Id::kFullOpenCV, "FULL_OPENCV", "fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6", 2, 2, 8, true},
    {Id::kFov, "FOV", "fx, fy, cx, cy, omega", 2, 2, 1, false},
    {Id::kSimpleRadialFisheye, "SIMPLE_RADIAL_FISHEYE", "f, cx, cy, k", 1, 2, 1, false},
    {Id::kRadialFisheye, "RADIAL_FISHEYE", "f, cx, cy, k1, k2", 1, 2, 2, false},
    {Id::kThinPrismFisheye, "THIN_PRISM_FISHEYE", "fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, sx1, sy1", 2, 2, 8,
     false},
    {Id::kRadTanThinPrismFisheye, "RAD_TAN_THIN_PRISM_FISHEYE",
     "fx, fy, cx, cy, k0, k1, k2, k3, k4, k5, p0, p1, s0, s1, s2, s3", 2, 2, 12, false},
    {Id::kSimpleDivision, "SIMPLE_DIVISION", "f, cx, cy, k", 1, 2, 1, false},
    {Id::kDivision, "DIVISION", "fx, fy, cx, cy, k", 2, 2, 1, false},
    {Id::kSimpleFisheye, "SIMPLE_FISHEYE", "f, cx, cy", 1, 2, 0, false},
    {Id::kFisheye, "FISHEYE", "fx, fy, cx, cy", 2, 2, 0, false},
    {Id::kEucm, "EUCM", "fx, fy, cx, cy, alpha, beta", 2, 2, 2, false},
    {Id::kEquirectangular, "EQUIRECTANGULAR", "w, h", 0, 0, 2, false},
}};

// Moves no pixel of an image with a focal length of at least 0.3 widths by more than a thousandth of a pixel.
constexpr double kNegligibleDistortion = 1e-8;

}  // namespace

const CameraModelInfo* FindCameraModel(int id) {
  return id >= 0 && id < static_cast<int>(kModels.size()) ? &kModels[id] : nullptr;
}

const CameraModelInfo* FindCameraModel(std::string_view name) {
  for (const CameraModelInfo& info : kModels) {
    if (info.name == name) return &info;
  }
  return nullptr;
}

const CameraModelInfo& InfoOf(CameraModelId id) {
  const CameraModelInfo* info = FindCameraModel(static_cast<int>(id));
  S2GS_INVARIANT(info != nullptr);
  return *info;
}

Eigen::Vector2d FocalLengths(const Camera& camera) {
  const CameraModelInfo& info = InfoOf(camera.model);
  S2GS_INVARIANT(info.num_focal_params > 0 && camera.params.size() == info.NumParams());
  return {camera.params[0], camera.params[info.num_focal_params - 1]};
}

Eigen::Vector2d PrincipalPoint(const Camera& camera) {
  const CameraModelInfo& info = InfoOf(camera.model);
  S2GS_INVARIANT(info.num_principal_point_params == 2 && camera.params.size() == info.NumParams());
  return {camera.params[info.num_focal_params], camera.params[info.num_focal_params + 1]};
}

bool IsDistortionFree(const Camera& camera) {
  const CameraModelInfo& info = InfoOf(camera.model);
  S2GS_INVARIANT(camera.params.size() == info.NumParams());
  size_t end = camera.params.size();
  switch (camera.model) {
    case Id::kSimplePinhole:
    case Id::kPinhole:
    case Id::kSimpleRadial:
    case Id::kRadial:
    case Id::kOpenCV:
    case Id::kFullOpenCV:
    case Id::kFov:
    case Id::kSimpleDivision:
    case Id::kDivision:
      break;
    case Id::kEucm:
      end = info.FirstExtraParam() + 1;  // beta has no effect when alpha is zero.
      break;
    case Id::kOpenCVFisheye:
    case Id::kSimpleRadialFisheye:
    case Id::kRadialFisheye:
    case Id::kThinPrismFisheye:
    case Id::kRadTanThinPrismFisheye:
    case Id::kSimpleFisheye:
    case Id::kFisheye:
    case Id::kEquirectangular:
      return false;
  }
  for (size_t i = info.FirstExtraParam(); i < end; ++i) {
    if (!(std::abs(camera.params[i]) <= kNegligibleDistortion)) return false;
  }
  return true;
}

void RequireProjection(const Camera& camera, const std::filesystem::path& path) {
  const CameraModelInfo& info = InfoOf(camera.model);
  if (info.has_projection) return;
  std::string supported;
  for (const CameraModelInfo& other : kModels) {
    if (other.has_projection) supported += (supported.empty() ? "" : ", ") + std::string(other.name);
  }
  throw UserError(path,
                  "camera " + std::to_string(camera.camera_id) + " has the model " + std::string(info.name) +
                      ", which s2gs cannot project (it can: " + supported + ")",
                  "Run `colmap image_undistorter` and use the PINHOLE model that it writes");
}

}  // namespace s2gs
