#include "mesh/surface/support_plane.h"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

constexpr size_t kMaxPatches = 10000;
constexpr int kNumTrials = 4000;
constexpr int kNumRefinements = 4;
// How far from the plane its surface may be, of the mesh's longest side without the outermost patches: smooth
// tables are found with the first, rough ones with the later.
constexpr std::array<double, 3> kTolerances = {0.005, 0.01, 0.02};
constexpr double kOutlierQuantile = 0.02;
constexpr double kMinCosine = 0.8;
constexpr double kMinShare = 0.1;
constexpr double kMaxShareBeneath = 0.2;
constexpr double kMinShareAbove = 0.05;

struct Patch {
  Eigen::Vector3d middle;
  Eigen::Vector3d normal;
  double area;
};

struct Plane {
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();
  double offset = 0;
  double Height(const Eigen::Vector3d& x) const { return normal.dot(x) - offset; }
};

std::vector<Patch> PatchesOf(const TriangleMesh& mesh) {
  const size_t stride = mesh.triangles.size() / kMaxPatches + 1;
  std::vector<Patch> patches;
  patches.reserve(mesh.triangles.size() / stride + 1);
  for (size_t t = 0; t < mesh.triangles.size(); t += stride) {
    std::array<Eigen::Vector3d, 3> corners;
    for (int i = 0; i < 3; ++i) corners[i] = mesh.vertices[mesh.triangles[t][i]].cast<double>();
    const Eigen::Vector3d cross = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
    const double norm = cross.norm();
    if (!(norm > 0)) continue;
    patches.push_back({(corners[0] + corners[1] + corners[2]) / 3, cross / norm, norm / 2});
  }
  return patches;
}

double LongestSide(const std::vector<Patch>& patches) {
  std::vector<double> values(patches.size());
  double longest = 0;
  for (int axis = 0; axis < 3; ++axis) {
    std::transform(patches.begin(), patches.end(), values.begin(),
                   [&](const Patch& patch) { return patch.middle[axis]; });
    longest = std::max(longest, Quantile(values, 1 - kOutlierQuantile) - Quantile(values, kOutlierQuantile));
  }
  return longest;
}

bool IsOn(const Plane& plane, const Patch& patch, double tolerance) {
  return std::abs(plane.Height(patch.middle)) < tolerance && plane.normal.dot(patch.normal) > kMinCosine;
}

// The plane's own area, or 0 where it cannot be what an object stands on.
double SupportingArea(const Plane& plane, const std::vector<Patch>& patches, double tolerance) {
  double total = 0;
  double on = 0;
  double beneath = 0;
  double above = 0;
  for (const Patch& patch : patches) {
    const double height = plane.Height(patch.middle);
    total += patch.area;
    on += IsOn(plane, patch, tolerance) ? patch.area : 0;
    beneath += height < -4 * tolerance ? patch.area : 0;
    above += height > 4 * tolerance ? patch.area : 0;
  }
  const bool supports =
      on >= kMinShare * total && beneath <= kMaxShareBeneath * total && above >= kMinShareAbove * total;
  return supports ? on : 0;
}

Plane Fit(const Plane& start, const std::vector<Patch>& patches, double tolerance) {
  double area = 0;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const Patch& patch : patches) {
    if (!IsOn(start, patch, tolerance)) continue;
    area += patch.area;
    mean += patch.area * patch.middle;
  }
  mean /= area;
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  for (const Patch& patch : patches) {
    if (!IsOn(start, patch, tolerance)) continue;
    const Eigen::Vector3d from_mean = patch.middle - mean;
    covariance += patch.area * from_mean * from_mean.transpose();
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(covariance);
  Plane plane;
  plane.normal = eigen.eigenvectors().col(0);
  if (plane.normal.dot(start.normal) < 0) plane.normal = -plane.normal;
  plane.offset = plane.normal.dot(mean);
  return plane;
}

std::optional<Plane> FindPlane(const std::vector<Patch>& patches, double tolerance) {
  // Numbers straight from the generator: those of <random>'s distributions differ between libraries.
  std::mt19937 generator(1);
  const auto pick = [&]() -> const Patch& { return patches[generator() % patches.size()]; };
  Plane best;
  double best_area = 0;
  for (int trial = 0; trial < kNumTrials; ++trial) {
    const std::array<const Patch*, 3> three = {&pick(), &pick(), &pick()};
    Plane plane;
    plane.normal = (three[1]->middle - three[0]->middle).cross(three[2]->middle - three[0]->middle);
    const double norm = plane.normal.norm();
    if (!(norm > 0)) continue;
    plane.normal /= plane.normal.dot(three[0]->normal) < 0 ? -norm : norm;
    plane.offset = plane.normal.dot(three[0]->middle);
    const bool face_its_way = std::all_of(three.begin(), three.end(), [&](const Patch* patch) {
      return plane.normal.dot(patch->normal) > kMinCosine;
    });
    if (!face_its_way) continue;
    const double area = SupportingArea(plane, patches, tolerance);
    if (area <= best_area) continue;
    best_area = area;
    best = plane;
  }
  if (!(best_area > 0)) return std::nullopt;
  for (int i = 0; i < kNumRefinements; ++i) {
    const Plane refined = Fit(best, patches, tolerance);
    if (!(SupportingArea(refined, patches, tolerance) > 0)) break;
    best = refined;
  }
  return best;
}

}  // namespace

std::optional<Eigen::Vector3d> FindSupportNormal(const TriangleMesh& mesh) {
  const std::vector<Patch> patches = PatchesOf(mesh);
  if (patches.size() < 3) return std::nullopt;
  const double side = LongestSide(patches);
  if (!(side > 0)) return std::nullopt;
  for (const double tolerance : kTolerances) {
    if (const std::optional<Plane> plane = FindPlane(patches, tolerance * side)) return plane->normal;
  }
  return std::nullopt;
}

}  // namespace s2gs
