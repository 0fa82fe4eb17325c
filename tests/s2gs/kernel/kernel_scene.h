#pragma once

#include <cmath>

#include "s2gs/kernel/composite.h"
#include "tests/support/random_numbers.h"

namespace s2gs {

/// A camera some 4 units from the origin, and the object turned against the world.
inline SplatCamera<double> KernelCamera(RandomNumbers& random) {
  const auto rotation = [&random](double spread) {
    Quat<double> q = {1, spread * random.Normal(), spread * random.Normal(), spread * random.Normal()};
    return RotationMatrix(q, 1 / std::sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z));
  };
  SplatCamera<double> camera{};
  camera.cam_from_world_rotation = rotation(0.2);
  camera.cam_from_world_translation = {0.1, -0.05, 4};
  camera.cam_from_object_rotation = rotation(1);
  camera.cam_from_object_translation = {-0.05, 0.1, 3.9};
  camera.fx = 60;
  camera.fy = 55;
  camera.cx = 25;
  camera.cy = 17;
  camera.near_depth = 0.05;
  camera.width = 48;
  camera.height = 36;
  return camera;
}

/// A Gaussian of some 5 to 20 px in the view.
inline SurfelParameters<double> RandomSurfel(RandomNumbers& random) {
  SurfelParameters<double> g{};
  g.centre = {0.6 * random.Normal(), 0.6 * random.Normal(), 0.6 * random.Normal()};
  g.log_scale = {random.Uniform(-2.5, -0.5), random.Uniform(-2.5, -0.5)};
  g.rotation = {random.Normal(), random.Normal(), random.Normal(), random.Normal()};
  g.opacity_logit = random.Uniform(-2, 4);
  g.foreground_logit = random.Uniform(-3, 4);
  return g;
}

template <typename To, typename From>
Vec3<To> Convert(const Vec3<From>& v) {
  return {To(v.x), To(v.y), To(v.z)};
}
template <typename To, typename From>
Mat3<To> Convert(const Mat3<From>& m) {
  return {Convert<To>(m.x), Convert<To>(m.y), Convert<To>(m.z)};
}
template <typename To, typename From>
SplatCamera<To> Convert(const SplatCamera<From>& c) {
  return {Convert<To>(c.cam_from_world_rotation),
          Convert<To>(c.cam_from_world_translation),
          Convert<To>(c.cam_from_object_rotation),
          Convert<To>(c.cam_from_object_translation),
          To(c.fx),
          To(c.fy),
          To(c.cx),
          To(c.cy),
          To(c.near_depth),
          c.width,
          c.height};
}

/// The parameters as an array, so that tests can loop over them.
constexpr int kNumSurfelParameters = 11;
template <typename T>
SurfelParameters<T> SurfelFromArray(const T* v) {
  return {{v[0], v[1], v[2]}, {v[3], v[4]}, {v[5], v[6], v[7], v[8]}, v[9], v[10]};
}
template <typename T>
void SurfelToArray(const SurfelParameters<T>& g, T* v) {
  const T values[kNumSurfelParameters] = {g.centre.x,    g.centre.y,      g.centre.z,        g.log_scale.x,
                                          g.log_scale.y, g.rotation.w,    g.rotation.x,      g.rotation.y,
                                          g.rotation.z,  g.opacity_logit, g.foreground_logit};
  for (int i = 0; i < kNumSurfelParameters; ++i) v[i] = values[i];
}

}  // namespace s2gs
