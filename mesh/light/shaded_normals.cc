#include "mesh/light/shaded_normals.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstddef>

#include "mesh/light/light_transfer.h"
#include "mesh/light/turn_light.h"
#include "s2gs/image/srgb.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

// Two angles and a colour from so many photos are known well beyond their noise.
constexpr size_t kLeastPhotos = 8;
constexpr int kRounds = 5;
constexpr int64_t kVerticesPerTurn = 256;
// Where steps between two directions are taken from [rad].
constexpr float kStep = 0.02F;
// Light of a longer step is another one.
constexpr double kMostStep = 0.3;
// Where the spread of normals begins, and beyond which a mesh is no surface [rad].
constexpr double kMostSpread = 15 * kPi / 180;
constexpr double kLeastSpread = 0.5 * kPi / 180;
constexpr double kLeastLight = 1.0 / 1024;

struct Vertex {
  size_t first = 0;  // of its samples
  size_t last = 0;
  Eigen::Vector3f own_normal;
  Eigen::Vector3f normal;
  LightTerms shadows;  // what the mesh takes from the open sky
  double color = 0;    // light that it sends back
  double sigma_rad = 0;
  bool is_known = false;
};

struct Sums {
  double products = 0;  // of errors with the next photo's, in their own sigmas
  double squares = 0;
  double spread = 0;  // of normals about the mesh's
  int64_t count = 0;
};

class Solver {
 public:
  Solver(const std::vector<ShadedSample>& samples, const std::vector<LightTerms>& lights)
      : samples_(samples),
        lights_(lights),
        light_(samples.size()),
        errors_(samples.size(), 0),
        is_compared_(samples.size(), 0) {
    for (size_t i = 0; i < samples.size(); ++i) light_[i] = LightFromSrgb(samples[i].grey / 255);
  }

  bool IsUsed(size_t i) const { return samples_[i].grey <= kBrightestGrey; }

  // The colour by the samples that the last errors leave, and the errors under it.
  void FindColor(Vertex* vertex) {
    const LightTerms transfer = OpenTransfer(vertex->normal) + vertex->shadows;
    double numerator = 0;
    double denominator = 0;
    for (size_t i = vertex->first; i < vertex->last; ++i) {
      if (!IsUsed(i)) continue;
      const double shade = Shade(i, transfer);
      const double weight = Weight(i);
      numerator += weight * shade * light_[i];
      denominator += weight * shade * shade;
    }
    vertex->color = denominator > 0 ? std::max(kLeastLight, numerator / denominator) : 0;
    for (size_t i = vertex->first; i < vertex->last; ++i) {
      if (!IsUsed(i)) continue;
      errors_[i] = Slope(i) * (vertex->color * Shade(i, transfer) - light_[i]);
      is_compared_[i] = 1;
    }
  }

  // One step of Gauss and Newton for the normal.
  void Step(Vertex* vertex, double spread, double photos_as_one, Sums* sums) const {
    const Eigen::Vector3f u = vertex->normal.unitOrthogonal();
    const Eigen::Vector3f v = vertex->normal.cross(u);
    const LightTerms transfer = OpenTransfer(vertex->normal) + vertex->shadows;
    const LightTerms along_u = Change(vertex->normal, u);
    const LightTerms along_v = Change(vertex->normal, v);
    Eigen::Matrix3d matrix = Eigen::Matrix3d::Zero();
    Eigen::Vector3d right = Eigen::Vector3d::Zero();
    double last = 0;
    for (size_t i = vertex->first; i < vertex->last; ++i) {
      if (!IsUsed(i)) continue;
      const LightTerms& light = lights_[samples_[i].photo];
      const double slope = Slope(i);
      const double color = slope * vertex->color;
      const Eigen::Vector3d jacobian(color * light.dot(along_u), color * light.dot(along_v),
                                     color * Shade(i, transfer));
      const double weight = RobustWeight(i) / (sigma_ * sigma_ * photos_as_one);
      matrix += weight * jacobian * jacobian.transpose();
      right -= weight * errors_[i] * jacobian;
      const double error = errors_[i] / sigma_ * std::sqrt(RobustWeight(i));
      sums->products += last * error;
      sums->squares += error * error;
      last = error;
    }
    const Eigen::Vector3f from_own = vertex->own_normal - vertex->normal;
    const double prior = 1 / (spread * spread);
    right[0] += prior * from_own.dot(u);
    right[1] += prior * from_own.dot(v);
    matrix(0, 0) += prior;
    matrix(1, 1) += prior;
    if (!(matrix(2, 2) > 0)) return;
    Eigen::Vector3d step = matrix.ldlt().solve(right);
    const double length = step.head<2>().norm();
    if (!std::isfinite(length)) return;
    step *= std::min(1.0, kMostStep / std::max(length, 1e-12));
    vertex->normal =
        (vertex->normal + static_cast<float>(step[0]) * u + static_cast<float>(step[1]) * v).normalized();
    const double variance = matrix.inverse().topLeftCorner<2, 2>().trace() / 2;
    vertex->sigma_rad = std::sqrt(std::max(0.0, variance));
    vertex->is_known = true;
    sums->spread += (vertex->normal - vertex->own_normal).squaredNorm() / 2 + variance;
    ++sums->count;
  }

  void FindSigma() {
    std::vector<double> sizes;
    sizes.reserve(errors_.size());
    for (size_t i = 0; i < errors_.size(); ++i) {
      if (is_compared_[i] != 0) sizes.push_back(std::abs(errors_[i]));
    }
    sigma_ = sizes.empty() ? kLeastLightSigma : std::max(kLeastLightSigma, kSigmaOfMad * UpperMedian(sizes));
  }

 private:
  double Shade(size_t i, const LightTerms& transfer) const {
    return std::max(kLeastLight, static_cast<double>(lights_[samples_[i].photo].dot(transfer)));
  }
  double Slope(size_t i) const {
    return 255 * SrgbSlope(std::max(kLeastLight, static_cast<double>(light_[i])));
  }
  double RobustWeight(size_t i) const {
    const double x = errors_[i] / (kLightCauchy * sigma_);
    return 1 / (1 + x * x);
  }
  double Weight(size_t i) const { return Slope(i) * Slope(i) * RobustWeight(i); }
  static LightTerms Change(const Eigen::Vector3f& normal, const Eigen::Vector3f& along) {
    return (OpenTransfer((normal + kStep * along).normalized()) -
            OpenTransfer((normal - kStep * along).normalized())) /
           (2 * kStep);
  }

  const std::vector<ShadedSample>& samples_;
  const std::vector<LightTerms>& lights_;
  std::vector<float> light_;          // of the samples
  std::vector<double> errors_;        // of the samples [grey values]
  std::vector<uint8_t> is_compared_;  // those of places that too few photos show are not
  double sigma_ = 255;                // of the errors: all count until they are known
};

std::vector<Vertex> FindVertices(const TriangleMesh& mesh, const TriangleMesh& smooth,
                                 const std::vector<ShadedSample>& samples, const LightTransfer& transfer) {
  std::vector<Vertex> vertices;
  for (size_t first = 0; first < samples.size();) {
    size_t last = first;
    while (last < samples.size() && samples[last].vertex == samples[first].vertex) ++last;
    if (last - first >= kLeastPhotos) {
      Vertex vertex;
      vertex.first = first;
      vertex.last = last;
      vertex.own_normal = vertex.normal = mesh.normals[samples[first].vertex];
      vertex.shadows =
          transfer.AtVertex(samples[first].vertex) - OpenTransfer(smooth.normals[samples[first].vertex]);
      vertices.push_back(vertex);
    }
    first = last;
  }
  return vertices;
}

}  // namespace

ShadedNormals FindShadedNormals(const TriangleMesh& mesh, const TriangleMesh& smooth,
                                const std::vector<uint8_t>& does_judge,
                                const std::vector<ShadedSample>& samples,
                                const std::vector<Eigen::Matrix3d>& world_from_object, int num_threads) {
  ShadedNormals found;
  if (samples.empty() || !Turns(world_from_object)) return found;
  const LightTransfer transfer(smooth, num_threads);
  std::vector<LightTerms> transfers;
  transfers.reserve(mesh.vertices.size());
  for (size_t i = 0; i < mesh.vertices.size(); ++i) transfers.push_back(transfer.AtVertex(i));
  std::vector<LitSample> lit;
  lit.reserve(samples.size());
  for (const ShadedSample& sample : samples)
    lit.push_back(
        {sample.vertex, sample.photo, Eigen::Array3f::Constant(sample.grey), does_judge[sample.vertex] != 0});
  const LightFinding finding = FitTurnLight(lit, transfers, world_from_object, num_threads);
  lit = {};
  found.error_even = finding.error_even;
  found.error_lit = finding.error_lit;
  if (finding.light.is_even()) return found;
  std::vector<LightTerms> lights;
  lights.reserve(world_from_object.size());
  for (const Eigen::Matrix3d& turn : world_from_object) lights.push_back(finding.light.Turned(turn).col(0));

  std::vector<Vertex> vertices = FindVertices(mesh, smooth, samples, transfer);
  Solver solver(samples, lights);
  const auto count = static_cast<int64_t>(vertices.size());
  const int64_t turns = (count + kVerticesPerTurn - 1) / kVerticesPerTurn;
  const auto for_each = [&](const auto& task) {
    ParallelFor(turns, num_threads, [&](int64_t turn) {
      const int64_t end = std::min(count, (turn + 1) * kVerticesPerTurn);
      for (int64_t i = turn * kVerticesPerTurn; i < end; ++i) task(turn, &vertices[i]);
    });
  };
  double spread = kMostSpread;
  double photos_as_one = 1;
  for (int round = 0; round < kRounds; ++round) {
    for (int pass = 0; pass < 2; ++pass) {
      for_each([&](int64_t, Vertex* vertex) { solver.FindColor(vertex); });
      solver.FindSigma();
    }
    std::vector<Sums> of_turns(turns);
    for_each(
        [&](int64_t turn, Vertex* vertex) { solver.Step(vertex, spread, photos_as_one, &of_turns[turn]); });
    Sums all;
    for (const Sums& sums : of_turns) {
      all.products += sums.products;
      all.squares += sums.squares;
      all.spread += sums.spread;
      all.count += sums.count;
    }
    if (all.count == 0) return found;
    // Errors that go on from photo to photo are the light's and the place's, and no noise: so many photos say
    // as much as one alone, as in a series whose errors follow their predecessors.
    const double following = std::clamp(all.products / std::max(all.squares, 1e-12), 0.0, 0.95);
    photos_as_one = (1 + following) / (1 - following);
    spread = std::clamp(std::sqrt(all.spread / static_cast<double>(all.count)), kLeastSpread, kMostSpread);
  }
  found.normals = mesh.normals;
  found.spread_rad = spread;
  found.sigma_rad.assign(mesh.vertices.size(), 0);
  for (const Vertex& vertex : vertices) {
    if (!vertex.is_known) continue;
    const uint32_t index = samples[vertex.first].vertex;
    found.normals[index] = vertex.normal;
    found.sigma_rad[index] = static_cast<float>(vertex.sigma_rad);
  }
  return found;
}

}  // namespace s2gs
