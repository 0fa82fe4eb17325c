#include "mesh/light/light_transfer.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

#include "mesh/light/mesh_raster.h"
#include "mesh/surface/object_view.h"
#include "s2gs/kernel/sh.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {
namespace {

// Directions from which the surface is looked at: half of them lie above a place, and the sum of so many is
// good to a hundredth of the light.
constexpr int kNumDirections = 192;
// Looked at together: as many pictures are in memory.
constexpr int kBatch = 16;
// Of the pictures [px].
constexpr int kSide = 512;
// From how many radii of the mesh: rays are parallel to a degree.
constexpr double kDistance = 50;
// Places are raised by so many pixels before they are looked for, so that their own surface does not hide
// them: within the pixels around, a plane comes no nearer than sqrt(2).
constexpr double kRaisedPixels = 2;
// Values of large triangles lie so far apart, in diagonals of the mesh's box.
constexpr double kSpacing = 0.01;
constexpr double kMaxSteps = 1024;
// Triangles grow large where the surface is flat: simplified ones are off by a tenth of a voxel, and lean 7
// degrees against their neighbours. Where a vertex's normal leans further, 15 degrees, it lies on an edge,
// which is none of the triangle's light.
constexpr float kCreaseCosine = 0.966F;
constexpr int64_t kPointsPerTurn = 4096;

// Spread evenly over the sphere (the golden angle's spiral).
Eigen::Vector3d Direction(int i) {
  const double z = 1 - (2 * i + 1.0) / kNumDirections;
  const double angle = kPi * (1 + std::sqrt(5.0)) * (i + 0.5);
  const double ring = std::sqrt(1 - z * z);
  return {ring * std::cos(angle), ring * std::sin(angle), z};
}

// The mesh's sphere as it is seen from that direction.
ObjectView LookFrom(const Eigen::Vector3d& direction, const Eigen::Vector3d& middle, double radius) {
  Eigen::Matrix3d rotation;
  rotation.row(2) = -direction;
  rotation.row(0) = direction.unitOrthogonal();
  rotation.row(1) = rotation.row(2).cross(rotation.row(0));
  ObjectView view;
  view.width = view.height = kSide;
  // The sphere's outline lies a little farther out than its great circle.
  view.fx = view.fy = (kSide / 2.0 - 1) * std::sqrt(kDistance * kDistance - 1);
  view.cx = view.cy = kSide / 2.0;
  view.cam_from_object.rotation = Eigen::Quaterniond(rotation);
  view.cam_from_object.translation = -(rotation * (middle + kDistance * radius * direction));
  return view;
}

// The share of the four pixels around that have nothing nearer.
float Visibility(const MeshRaster& raster, const ObjectView& view, const Eigen::Vector3d& x_in_object) {
  const Eigen::Vector3d x = view.cam_from_object * x_in_object;
  const double column = std::clamp(view.fx * x.x() / x.z() + view.cx - 0.5, 0.0, kSide - 1.0);
  const double row = std::clamp(view.fy * x.y() / x.z() + view.cy - 0.5, 0.0, kSide - 1.0);
  const int x0 = std::min(static_cast<int>(column), kSide - 2);
  const int y0 = std::min(static_cast<int>(row), kSide - 2);
  const auto own = static_cast<float>(1 / x.z());
  float visible = 0;
  for (int i = 0; i < 4; ++i) {
    const double weight =
        (1 - std::abs(column - (x0 + i % 2))) * (1 - std::abs(row - (y0 + i / 2)));  // NOLINT
    const size_t at = static_cast<size_t>(y0 + i / 2) * kSide + static_cast<size_t>(x0 + i % 2);
    if (raster.inverse_depths[at] <= own) visible += static_cast<float>(weight);
  }
  return visible;
}

// Row i, so many steps towards the first corner, has steps + 1 - i values.
size_t LatticeIndex(size_t steps, size_t i, size_t j) { return i * (steps + 1) - i * (i - 1) / 2 + j; }

}  // namespace

LightTerms LightHarmonics(const Eigen::Vector3f& direction) {
  LightTerms terms;
  terms[0] = static_cast<float>(kShBand0);
  ShRestBasis<float>(3, {direction.x(), direction.y(), direction.z()}, terms.data() + 1);
  return terms;
}

LightTerms OpenTransfer(const Eigen::Vector3f& normal) {
  LightTerms terms = LightHarmonics(normal);
  terms[0] *= static_cast<float>(kPi);
  terms.segment<3>(1) *= static_cast<float>(2 * kPi / 3);
  terms.segment<5>(4) *= static_cast<float>(kPi / 4);
  terms.segment<7>(9).setZero();
  return terms;
}

LightTransfer::LightTransfer(const TriangleMesh& mesh, int num_threads) : triangles_(mesh.triangles) {
  Eigen::AlignedBox3d box;
  for (const Eigen::Vector3f& vertex : mesh.vertices) box.extend(vertex.cast<double>());
  const double diagonal = box.diagonal().norm();
  std::vector<Point> points;
  points.reserve(mesh.vertices.size());
  for (size_t i = 0; i < mesh.vertices.size(); ++i) points.push_back({mesh.vertices[i], mesh.normals[i]});
  AddLattices(mesh, kSpacing * diagonal, &points);
  // What is hidden comes off what an open sky adds: sums over directions are no more exact than these are
  // many.
  values_.reserve(points.size());
  for (const Point& point : points) values_.push_back(OpenTransfer(point.normal));
  const double radius = diagonal / 2;
  const auto raised = static_cast<float>(kRaisedPixels * 2 * radius / kSide);
  constexpr float kShare = 4 * static_cast<float>(kPi) / kNumDirections;
  std::vector<ObjectView> views(kBatch);
  std::vector<MeshRaster> rasters(kBatch);
  for (int begin = 0; begin < kNumDirections; begin += kBatch) {
    const int count = std::min(kBatch, kNumDirections - begin);
    ParallelFor(count, num_threads, [&](int64_t i) {
      views[i] = LookFrom(Direction(begin + static_cast<int>(i)), box.center(), radius);
      rasters[i] = RasterizeMesh(mesh.vertices, mesh.triangles, views[i], false);
    });
    ParallelFor(static_cast<int64_t>(points.size()), num_threads, kPointsPerTurn, [&](int64_t p) {
      const Point& point = points[p];
      const Eigen::Vector3d x = (point.x + raised * point.normal).cast<double>();
      for (int i = 0; i < count; ++i) {
        const Eigen::Vector3f direction = Direction(begin + i).cast<float>();
        const float cosine = point.normal.dot(direction);
        if (!(cosine > 0)) continue;
        const float hidden = 1 - Visibility(rasters[i], views[i], x);
        if (hidden > 0) values_[p] -= kShare * cosine * hidden * LightHarmonics(direction);
      }
    });
  }
}

void LightTransfer::AddLattices(const TriangleMesh& mesh, double spacing, std::vector<Point>* points) {
  steps_.assign(mesh.triangles.size(), 1);
  first_.assign(mesh.triangles.size(), 0);
  for (size_t t = 0; t < mesh.triangles.size(); ++t) {
    const Triangle& corners = mesh.triangles[t];
    double longest = 0;
    for (int i = 0; i < 3; ++i) {
      const Eigen::Vector3f edge = mesh.vertices[corners[i]] - mesh.vertices[corners[(i + 1) % 3]];
      longest = std::max<double>(longest, edge.norm());
    }
    const double steps = std::ceil(longest / spacing);
    if (!(steps > 1)) continue;
    std::array<Eigen::Vector3f, 3> positions;
    std::array<Eigen::Vector3f, 3> normals;
    for (int i = 0; i < 3; ++i) {
      positions[i] = mesh.vertices[corners[i]];
      normals[i] = mesh.normals[corners[i]];
    }
    const Eigen::Vector3f own = (positions[1] - positions[0]).cross(positions[2] - positions[0]).normalized();
    for (Eigen::Vector3f& normal : normals) {
      if (!(normal.dot(own) > kCreaseCosine)) normal = own;
    }
    steps_[t] = static_cast<uint16_t>(std::min(steps, kMaxSteps));
    first_[t] = static_cast<uint32_t>(points->size());
    for (int i = 0; i <= steps_[t]; ++i) {
      for (int j = 0; j <= steps_[t] - i; ++j) {
        const float u = static_cast<float>(i) / static_cast<float>(steps_[t]);
        const float v = static_cast<float>(j) / static_cast<float>(steps_[t]);
        const auto mean = [&](const std::array<Eigen::Vector3f, 3>& of) -> Eigen::Vector3f {
          return u * of[0] + v * of[1] + (1 - u - v) * of[2];
        };
        points->push_back({mean(positions), mean(normals).normalized()});
      }
    }
  }
}

LightTerms LightTransfer::At(uint32_t triangle, float u, float v) const {
  const int steps = steps_[triangle];
  if (steps == 1) {
    const Triangle& corners = triangles_[triangle];
    return u * values_[corners[0]] + v * values_[corners[1]] + (1 - u - v) * values_[corners[2]];
  }
  // In the lattice's cell: two triangles.
  const float a = std::clamp(u, 0.0F, 1.0F) * static_cast<float>(steps);
  const float b = std::clamp(v, 0.0F, 1.0F) * static_cast<float>(steps);
  const int i = std::min(static_cast<int>(a), steps - 1);
  const int j = std::min(static_cast<int>(b), steps - 1 - i);
  const float x = a - static_cast<float>(i);
  const float y = std::max(0.0F, b - static_cast<float>(j));
  const auto value = [&](int row, int column) -> const LightTerms& {
    return values_[first_[triangle] + LatticeIndex(steps, row, column)];
  };
  if (x + y <= 1 || i + j + 2 > steps) {
    return (1 - x - y) * value(i, j) + x * value(i + 1, j) + y * value(i, j + 1);
  }
  return (x + y - 1) * value(i + 1, j + 1) + (1 - y) * value(i + 1, j) + (1 - x) * value(i, j + 1);
}

}  // namespace s2gs
