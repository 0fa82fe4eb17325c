#pragma once

#include <Eigen/Core>
#include <cmath>

#include "sfm_split/scene/camera_model.h"

namespace s2gs {

/// x / z, y / z of a pinhole to the same after the lens, for the perspective models; theta * (cos phi, sin
/// phi) to the same for OPENCV_FISHEYE. Polynomials and quotients only, so any number type will do. \param
/// extra  the model's parameters after the principal point.
template <typename T>
void DistortNormalized(CameraModelId model, const T* extra, const T& u, const T& v, T* distorted_u,
                       T* distorted_v) {
  const T r2 = u * u + v * v;
  switch (model) {
    case CameraModelId::kSimpleRadial: {
      const T radial = T(1) + extra[0] * r2;
      *distorted_u = u * radial;
      *distorted_v = v * radial;
      return;
    }
    case CameraModelId::kRadial: {
      const T radial = T(1) + r2 * (extra[0] + r2 * extra[1]);
      *distorted_u = u * radial;
      *distorted_v = v * radial;
      return;
    }
    case CameraModelId::kOpenCVFisheye: {
      const T radial = T(1) + r2 * (extra[0] + r2 * (extra[1] + r2 * (extra[2] + r2 * extra[3])));
      *distorted_u = u * radial;
      *distorted_v = v * radial;
      return;
    }
    case CameraModelId::kOpenCV:
    case CameraModelId::kFullOpenCV: {
      T radial = T(1) + r2 * (extra[0] + r2 * extra[1]);
      if (model == CameraModelId::kFullOpenCV) {
        const T numerator = radial + r2 * r2 * r2 * extra[4];
        const T denominator = T(1) + r2 * (extra[5] + r2 * (extra[6] + r2 * extra[7]));
        radial = numerator / denominator;
      }
      const T& p1 = extra[2];
      const T& p2 = extra[3];
      const T uv2 = T(2) * u * v;
      *distorted_u = u * radial + p1 * uv2 + p2 * (r2 + T(2) * u * u);
      *distorted_v = v * radial + p2 * uv2 + p1 * (r2 + T(2) * v * v);
      return;
    }
    default:
      *distorted_u = u;
      *distorted_v = v;
      return;
  }
}

/// Projects a point with a model that has a projection (CameraModelInfo::has_projection). T may be float,
/// double or a dual number such as ceres::Jet, whose derivatives are finite wherever this returns true.
/// \param params    all parameters of the model.
/// \param x_in_cam  3 coordinates in the camera's frame.
/// \param xy        2 pixel coordinates.
/// \return  false, and xy untouched, unless the point lies in front of the camera plane. Points beyond the
/// radius at which the lens polynomial turns back are projected all the same (ProjectToImage refuses them).
template <typename T>
bool ProjectPoint(CameraModelId model, const T* params, const T* x_in_cam, T* xy) {
  using std::atan2;
  using std::sqrt;
  const T& z = x_in_cam[2];
  if (!(z > T(0))) return false;
  T u = x_in_cam[0] / z;
  T v = x_in_cam[1] / z;
  if (model == CameraModelId::kOpenCVFisheye) {
    // theta / tan(theta). Near the axis the root has no derivative; the series' next term is below rounding.
    const T t = u * u + v * v;
    T ratio = T(1) - t * (T(1) / T(3) - t / T(5));
    if (t > T(1e-5)) {
      const T r = sqrt(x_in_cam[0] * x_in_cam[0] + x_in_cam[1] * x_in_cam[1]);
      ratio = atan2(r, z) * z / r;
    }
    u *= ratio;
    v *= ratio;
  }
  const bool one_focal = model == CameraModelId::kSimplePinhole || model == CameraModelId::kSimpleRadial ||
                         model == CameraModelId::kRadial;
  const int first_extra = one_focal ? 3 : 4;
  T distorted_u;
  T distorted_v;
  DistortNormalized(model, params + first_extra, u, v, &distorted_u, &distorted_v);
  const T& fy = params[one_focal ? 0 : 1];
  xy[0] = params[0] * distorted_u + params[first_extra - 2];
  xy[1] = fy * distorted_v + params[first_extra - 1];
  return true;
}

}  // namespace s2gs
