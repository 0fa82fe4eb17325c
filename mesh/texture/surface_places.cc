#include "mesh/texture/surface_places.h"

#include <Eigen/Geometry>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "s2gs/core/rng.h"

namespace s2gs {

std::vector<SurfacePlace> PlacesOnSurface(const TriangleMesh& mesh, int count) {
  const auto area_of = [&](const Triangle& t) {
    const Eigen::Vector3d a = mesh.vertices[t[0]].cast<double>();
    return 0.5 *
           (mesh.vertices[t[1]].cast<double>() - a).cross(mesh.vertices[t[2]].cast<double>() - a).norm();
  };
  double total = 0;
  for (const Triangle& t : mesh.triangles) total += area_of(t);
  std::vector<SurfacePlace> places;
  if (!(total > 0) || !std::isfinite(total)) return places;
  places.reserve(count);
  const double share = total / count;
  double sum = 0;
  for (size_t i = 0; i < mesh.triangles.size(); ++i) {
    const Triangle& t = mesh.triangles[i];
    sum += area_of(t);
    // A place for each whole share that ends in this triangle.
    while (sum > share * (static_cast<double>(places.size()) + 0.5) &&
           places.size() < static_cast<size_t>(count)) {
      const Random4 bits = RandomBits(0, 0, places.size());
      float u = UnitFloat(bits.words[0]);
      float v = UnitFloat(bits.words[1]);
      if (u + v > 1) {
        u = 1 - u;
        v = 1 - v;
      }
      const float w = 1 - u - v;
      SurfacePlace place;
      place.x = u * mesh.vertices[t[0]] + v * mesh.vertices[t[1]] + w * mesh.vertices[t[2]];
      place.normal = (u * mesh.normals[t[0]] + v * mesh.normals[t[1]] + w * mesh.normals[t[2]]).normalized();
      place.area = share;
      place.triangle = static_cast<uint32_t>(i);
      place.u = u;
      place.v = v;
      places.push_back(place);
    }
  }
  return places;
}

}  // namespace s2gs
