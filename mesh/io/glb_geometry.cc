#include "mesh/io/glb_geometry.h"

#include <ostream>

namespace s2gs {
namespace {

nlohmann::json Floats(const Eigen::Vector3f& vector) { return {vector.x(), vector.y(), vector.z()}; }

template <typename Value>
void WriteArray(std::ostream& stream, const Value* values, uint64_t count) {
  stream.write(reinterpret_cast<const char*>(values), static_cast<std::streamsize>(count * sizeof(Value)));
}

}  // namespace

void AddGlbPositions(const std::vector<Eigen::Vector3f>& vertices, GlbBuilder* glb,
                     nlohmann::json* primitive) {
  Eigen::Vector3f low = vertices.front();
  Eigen::Vector3f high = low;
  for (const Eigen::Vector3f& vertex : vertices) {
    low = low.cwiseMin(vertex);
    high = high.cwiseMax(vertex);
  }
  (*primitive)["attributes"]["POSITION"] = glb->AddAccessor(
      vertices.size(), 12 * vertices.size(), kGlbArrayBuffer,
      {{"componentType", kGlbFloat}, {"type", "VEC3"}, {"min", Floats(low)}, {"max", Floats(high)}},
      [&vertices](std::ostream& out) { WriteArray(out, vertices.data(), vertices.size()); });
}

void AddGlbNormals(const std::vector<Eigen::Vector3f>& normals, GlbBuilder* glb, nlohmann::json* primitive) {
  (*primitive)["attributes"]["NORMAL"] =
      glb->AddAccessor(normals.size(), 12 * normals.size(), kGlbArrayBuffer,
                       {{"componentType", kGlbFloat}, {"type", "VEC3"}}, [&normals](std::ostream& out) {
                         for (const Eigen::Vector3f& normal : normals) {
                           const float norm = normal.norm();
                           const Eigen::Vector3f unit = norm > 0 ? Eigen::Vector3f(normal / norm)
                                                                 : Eigen::Vector3f(Eigen::Vector3f::UnitZ());
                           WriteArray(out, &unit, 1);
                         }
                       });
}

void AddGlbTriangles(const Triangle* triangles, uint64_t count, GlbBuilder* glb, nlohmann::json* primitive) {
  (*primitive)["indices"] = glb->AddAccessor(
      3 * count, 12 * count, kGlbElementArrayBuffer, {{"componentType", kGlbUnsignedInt}, {"type", "SCALAR"}},
      [triangles, count](std::ostream& out) { WriteArray(out, triangles, count); });
}

}  // namespace s2gs
