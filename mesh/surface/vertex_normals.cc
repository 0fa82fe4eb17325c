#include "mesh/surface/vertex_normals.h"

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace s2gs {

void ComputeNormals(TriangleMesh* mesh) {
  // In double: the squares of small triangles' areas must not vanish.
  std::vector<Eigen::Vector3d> sums(mesh->vertices.size(), Eigen::Vector3d::Zero());
  for (const auto& triangle : mesh->triangles) {
    const Eigen::Vector3d corner = mesh->vertices[triangle[0]].cast<double>();
    const Eigen::Vector3d normal = (mesh->vertices[triangle[1]].cast<double>() - corner)
                                       .cross(mesh->vertices[triangle[2]].cast<double>() - corner);
    for (int i = 0; i < 3; ++i) sums[triangle[i]] += normal;
  }
  mesh->normals.resize(mesh->vertices.size());
  for (size_t i = 0; i < sums.size(); ++i) {
    const double norm = sums[i].norm();
    mesh->normals[i] = norm > 0 ? Eigen::Vector3f((sums[i] / norm).cast<float>())
                                : Eigen::Vector3f(Eigen::Vector3f::UnitZ());
  }
}

}  // namespace s2gs
