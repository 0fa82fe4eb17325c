#include "mesh/surface/mesh_cleanup.h"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <optional>
#include <utility>
#include <vector>

#include "mesh/surface/decimate.h"
#include "mesh/surface/support_plane.h"
#include "mesh/surface/triangle_tree.h"
#include "sfm_split/base/angles.h"
#include "tests/mesh/surface/mesh_topology.h"
#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

using Triangle = Eigen::Matrix<uint32_t, 3, 1>;

// An icosahedron whose triangles are divided into four `levels` times, on a sphere.
TriangleMesh Ball(int levels, double radius, const Eigen::Vector3d& middle = Eigen::Vector3d::Zero()) {
  const double g = (1 + std::sqrt(5.0)) / 2;
  std::vector<Eigen::Vector3d> points;
  for (const double a : {-1.0, 1.0}) {
    for (const double b : {-g, g}) {
      points.emplace_back(0, a, b);
      points.emplace_back(a, b, 0);
      points.emplace_back(b, 0, a);
    }
  }
  std::vector<Triangle> triangles;
  for (uint32_t i = 0; i < 12; ++i) {
    for (uint32_t j = 0; j < 12; ++j) {
      for (uint32_t k = 0; k < 12; ++k) {
        if (i > j || i > k || i == j || j == k) continue;
        const double ij = (points[i] - points[j]).norm();
        const double jk = (points[j] - points[k]).norm();
        const double ki = (points[k] - points[i]).norm();
        if (std::max({ij, jk, ki}) > 2.01) continue;
        if (points[i].dot(points[j].cross(points[k])) > 0) triangles.emplace_back(i, j, k);
      }
    }
  }
  for (int level = 0; level < levels; ++level) {
    std::map<std::pair<uint32_t, uint32_t>, uint32_t> middles;
    const auto between = [&](uint32_t v, uint32_t w) {
      const auto [entry, is_new] = middles.try_emplace({std::min(v, w), std::max(v, w)}, points.size());
      if (is_new) points.emplace_back(points[v] + points[w]);
      return entry->second;
    };
    std::vector<Triangle> finer;
    for (Eigen::Vector3d& point : points) point.normalize();
    for (const Triangle& t : triangles) {
      const uint32_t a = between(t[0], t[1]);
      const uint32_t b = between(t[1], t[2]);
      const uint32_t c = between(t[2], t[0]);
      finer.insert(finer.end(), {{t[0], a, c}, {a, t[1], b}, {c, b, t[2]}, {a, b, c}});
    }
    triangles = finer;
  }
  TriangleMesh mesh;
  for (const Eigen::Vector3d& point : points) {
    mesh.vertices.emplace_back((middle + radius * point.normalized()).cast<float>());
  }
  mesh.triangles = triangles;
  return mesh;
}

void Append(const TriangleMesh& part, TriangleMesh* mesh) {
  const auto first = static_cast<uint32_t>(mesh->vertices.size());
  mesh->vertices.insert(mesh->vertices.end(), part.vertices.begin(), part.vertices.end());
  for (const Triangle& triangle : part.triangles) mesh->triangles.emplace_back(triangle.array() + first);
}

// A flat round plate that faces upwards, and its underside.
TriangleMesh Plate(double radius, double top, double thickness) {
  constexpr int kSegments = 64;
  constexpr int kRings = 20;
  TriangleMesh mesh;
  for (const double z : {top, top - thickness}) {
    const auto first = static_cast<uint32_t>(mesh.vertices.size());
    mesh.vertices.emplace_back(0.0F, 0.0F, static_cast<float>(z));
    for (int ring = 1; ring <= kRings; ++ring) {
      for (int i = 0; i < kSegments; ++i) {
        const double angle = 2 * kPi * i / kSegments;
        const double r = radius * ring / kRings;
        mesh.vertices.emplace_back(
            Eigen::Vector3d(r * std::cos(angle), r * std::sin(angle), z).cast<float>());
      }
    }
    const auto at = [&](int ring, int i) {
      return ring == 0 ? first : first + 1 + static_cast<uint32_t>((ring - 1) * kSegments + i % kSegments);
    };
    const bool is_top = z == top;
    for (int ring = 0; ring < kRings; ++ring) {
      for (int i = 0; i < kSegments; ++i) {
        const auto add = [&](uint32_t a, uint32_t b, uint32_t c) {
          is_top ? mesh.triangles.emplace_back(a, b, c) : mesh.triangles.emplace_back(a, c, b);
        };
        add(at(ring, i), at(ring + 1, i), at(ring + 1, i + 1));
        if (ring > 0) add(at(ring, i), at(ring + 1, i + 1), at(ring, i + 1));
      }
    }
  }
  return mesh;
}

TEST(MeshCleanup, TestShapesAreSound) {
  const MeshTopology ball = TopologyOf(Ball(3, 1));
  EXPECT_EQ(ball.euler_characteristic, 2);
  EXPECT_EQ(ball.num_boundary_edges, 0);
  EXPECT_EQ(ball.num_bad_edges, 0);
  EXPECT_NEAR(ball.volume, 4 * kPi / 3, 0.04);  // inscribed
  EXPECT_NEAR(TopologyOf(Plate(2, 0, 0.1)).area, 2 * 4 * kPi, 0.1);
}

TEST(MeshCleanup, DropsSmallClusters) {
  TriangleMesh mesh = Ball(1, 0.15, {3, 0, 0});  // .6 % of the largest one's area
  Append(Ball(3, 2), &mesh);
  Append(Ball(2, 0.25, {0, 5, 0}), &mesh);  // 1.6 %
  mesh.colors.resize(mesh.vertices.size());
  for (size_t i = 0; i < mesh.colors.size(); ++i) {
    mesh.colors[i] = Eigen::Vector3i(mesh.vertices[i].norm() > 2.5F ? 200 : 10, 0, 0).cast<uint8_t>();
  }
  Reporter silent;
  MeshCleanupOptions options;
  TriangleMesh two = mesh;
  MeshCleanupSummary summary = CleanMesh(options, silent, &two);
  EXPECT_EQ(summary.num_clusters, 3);
  EXPECT_EQ(summary.num_clusters_kept, 2);
  EXPECT_EQ(TopologyOf(two).num_components, 2);
  EXPECT_EQ(TopologyOf(two).num_unused_vertices, 0);
  for (size_t i = 0; i < two.vertices.size(); ++i) {
    EXPECT_EQ(two.colors[i].x(), two.vertices[i].norm() > 2.5F ? 200 : 10);
  }
  options.min_cluster_area_pct = 100;
  summary = CleanMesh(options, silent, &mesh);
  EXPECT_EQ(summary.num_clusters_kept, 1);
  EXPECT_NEAR(TopologyOf(mesh).area, 16 * kPi, 0.5);
  TriangleMesh empty;
  EXPECT_EQ(CleanMesh(options, silent, &empty).num_clusters, 0);
}

// The largest cluster is asked about as well: it goes like any other where it is not there.
TEST(MeshCleanup, AsksPhotosAboutClusters) {
  Reporter silent;
  MeshCleanupOptions options;
  options.cut_at_table = false;
  options.min_cluster_area_pct = 10;
  TriangleMesh mesh = Ball(2, 1);
  Append(Ball(2, 0.5, {5, 0, 0}), &mesh);  // a quarter of the area
  Append(Ball(2, 0.2, {-5, 0, 0}), &mesh);
  const auto kept = [&](PartSight large, PartSight small) {
    TriangleMesh copy = mesh;
    const MeshCleanupSummary summary =
        CleanMesh(options, silent, &copy, [&](const TriangleMesh&, const std::vector<int>&) {
          return std::vector<PartSight>{PartSight::kUnknown, large, small};
        });
    EXPECT_EQ(summary.num_large_dropped, large == PartSight::kNotThere ? 1 : 0);
    EXPECT_EQ(summary.num_small_kept, small == PartSight::kThere ? 1 : 0);
    return summary.num_clusters_kept;
  };
  EXPECT_EQ(kept(PartSight::kUnknown, PartSight::kUnknown), 2);
  EXPECT_EQ(kept(PartSight::kThere, PartSight::kThere), 3);
  EXPECT_EQ(kept(PartSight::kNotThere, PartSight::kNotThere), 1);
  // Areas decide alone where all are kept, or the largest.
  const PartJudge never = [](const TriangleMesh&, const std::vector<int>&) {
    ADD_FAILURE() << "photos are asked";
    return std::vector<PartSight>();
  };
  for (const double pct : {0.0, 100.0}) {
    options.min_cluster_area_pct = pct;
    TriangleMesh copy = mesh;
    EXPECT_EQ(CleanMesh(options, silent, &copy, never).num_clusters_kept, pct == 0 ? 3 : 1);
  }
}

// 100 % keeps the largest cluster whatever its area is rounded to.
TEST(MeshCleanup, KeepsTheLargestAlone) {
  Reporter silent;
  MeshCleanupOptions options;
  options.min_cluster_area_pct = 100;
  for (int i = 0; i < 200; ++i) {
    TriangleMesh mesh = Ball(0, 1 + 0.01 * i);
    Append(Ball(0, 0.9, {5, 0, 0}), &mesh);
    EXPECT_EQ(CleanMesh(options, silent, &mesh).num_clusters_kept, 1) << i;
  }
}

TEST(MeshCleanup, ClosesHolesUpToASize) {
  TriangleMesh mesh = Ball(3, 1);
  // A hole of one triangle, one of the six around a vertex, and two that touch in a vertex.
  std::vector<bool> keep(mesh.triangles.size(), true);
  keep[0] = false;
  const uint32_t middle = mesh.triangles[700][0];
  for (size_t t = 0; t < keep.size(); ++t) {
    if ((mesh.triangles[t].array() == middle).any()) keep[t] = false;
  }
  const uint32_t touching = mesh.triangles[300][1];
  int around = 0;
  for (size_t t = 0; t < keep.size(); ++t) {
    if ((mesh.triangles[t].array() == touching).any() && ++around % 3 == 1) keep[t] = false;
  }
  KeepTriangles(keep, &mesh);
  ASSERT_GT(TopologyOf(mesh).num_boundary_edges, 9);
  TriangleMesh partly = mesh;
  const int num_small = CloseHoles(3, &partly);
  EXPECT_GE(num_small, 1);
  EXPECT_GT(TopologyOf(partly).num_boundary_edges, 0);
  EXPECT_GT(CloseHoles(20, &mesh), num_small);
  const MeshTopology topology = TopologyOf(mesh);
  EXPECT_EQ(topology.num_boundary_edges, 0);
  EXPECT_EQ(topology.num_bad_edges, 0);
  EXPECT_EQ(topology.euler_characteristic, 2);
  EXPECT_NEAR(topology.volume, 4 * kPi / 3, 0.06);
  EXPECT_EQ(CloseHoles(20, &mesh), 0);
}

TEST(MeshCleanup, SmoothingTakesNoiseAndKeepsTheVolume) {
  TriangleMesh mesh = Ball(4, 1);
  RandomNumbers random(2);
  for (Eigen::Vector3f& vertex : mesh.vertices) vertex *= static_cast<float>(1 + 0.01 * random.Normal());
  const auto roughness = [](const TriangleMesh& ball) {
    double sum = 0;
    for (const Eigen::Vector3f& vertex : ball.vertices) sum += std::pow(vertex.norm() - 1, 2);
    return std::sqrt(sum / static_cast<double>(ball.vertices.size()));
  };
  const double before = roughness(mesh);
  const double volume = TopologyOf(mesh).volume;
  SmoothMesh(20, &mesh);
  EXPECT_LT(roughness(mesh), 0.45 * before);
  EXPECT_NEAR(TopologyOf(mesh).volume, volume, 0.005 * volume);
}

TEST(MeshCleanup, SmoothingLeavesOutlines) {
  TriangleMesh mesh = Plate(1, 0, 0.1);
  const TriangleMesh before = mesh;
  SmoothMesh(5, &mesh);
  for (size_t i = 0; i < mesh.vertices.size(); ++i) {
    if (before.vertices[i].head<2>().norm() < 0.999F) continue;
    EXPECT_EQ(mesh.vertices[i], before.vertices[i]);
  }
}

TEST(MeshCleanup, DecimationKeepsShapeAndTopology) {
  TriangleMesh mesh = Ball(4, 1);  // 5,120 triangles
  mesh.colors.assign(mesh.vertices.size(), {10, 20, 30});
  DecimateMesh(1000, &mesh);
  EXPECT_LE(mesh.triangles.size(), 1000u);
  EXPECT_GT(mesh.triangles.size(), 990u);
  const MeshTopology topology = TopologyOf(mesh);
  EXPECT_EQ(topology.num_boundary_edges, 0);
  EXPECT_EQ(topology.num_bad_edges, 0);
  EXPECT_EQ(topology.euler_characteristic, 2);
  EXPECT_NEAR(topology.volume, 4 * kPi / 3, 0.02 * 4 * kPi / 3);
  double worst = 0;
  for (const Eigen::Vector3f& vertex : mesh.vertices)
    worst = std::max(worst, std::abs(double{vertex.norm()} - 1));
  EXPECT_LT(worst, 0.01);
  for (const auto& color : mesh.colors) EXPECT_EQ(color, (Eigen::Matrix<uint8_t, 3, 1>(10, 20, 30)));
}

// Nothing smaller encloses a volume.
TEST(MeshCleanup, DecimationLeavesATetrahedron) {
  TriangleMesh mesh;
  mesh.vertices = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  mesh.triangles = {{0, 2, 1}, {0, 1, 3}, {0, 3, 2}, {1, 2, 3}};
  DecimateMesh(1, &mesh);
  EXPECT_EQ(mesh.triangles.size(), 4u);
  EXPECT_NEAR(TopologyOf(mesh).volume, 1.0 / 6, 1e-6);
}

// A plane needs few triangles, and its outline stays.
TEST(MeshCleanup, DecimationKeepsOutlines) {
  TriangleMesh mesh = Plate(1, 0.5, 0.1);
  const double area = TopologyOf(mesh).area;
  const size_t before = mesh.triangles.size();
  DecimateMesh(400, &mesh);
  EXPECT_LT(mesh.triangles.size(), before / 4);
  EXPECT_NEAR(TopologyOf(mesh).area, area, 0.02 * area);
  EXPECT_EQ(TopologyOf(mesh).num_bad_edges, 0);
}

// A strip one square wide: all its inner edges join two outlines, and none may become a point.
TEST(MeshCleanup, DecimationPinchesNoStrip) {
  TriangleMesh mesh;
  constexpr uint32_t kSquares = 40;
  for (uint32_t i = 0; i <= kSquares; ++i) {
    for (int side = 0; side < 2; ++side)
      mesh.vertices.emplace_back(0.1F * static_cast<float>(i), 0.1F * static_cast<float>(side), 0);
  }
  for (uint32_t i = 0; i < kSquares; ++i) {
    mesh.triangles.emplace_back(2 * i, 2 * i + 2, 2 * i + 3);
    mesh.triangles.emplace_back(2 * i, 2 * i + 3, 2 * i + 1);
  }
  DecimateMesh(8, &mesh);
  const MeshTopology topology = TopologyOf(mesh);
  EXPECT_LE(mesh.triangles.size(), 8U);
  EXPECT_NEAR(topology.area, 0.4, 1e-6);
  EXPECT_EQ(topology.num_bad_edges, 0);
  EXPECT_EQ(topology.euler_characteristic, 1);
}

// A sheet with two holes, of irregular triangles: none turns over, holes stay, and where nothing but the
// place tells a colour, it goes on telling it.
TEST(MeshCleanup, DecimationOfASheetTurnsNoTriangleOver) {
  constexpr int kSide = 40;
  RandomNumbers random(3);
  TriangleMesh mesh;
  std::map<std::pair<int, int>, uint32_t> numbers;
  const auto vertex = [&](int i, int j) {
    const auto [entry, is_new] = numbers.try_emplace({i, j}, static_cast<uint32_t>(mesh.vertices.size()));
    if (is_new) {
      const double x = (i + random.Uniform(-0.3, 0.3)) / kSide;
      mesh.vertices.emplace_back(static_cast<float>(x),
                                 static_cast<float>((j + random.Uniform(-0.3, 0.3)) / kSide), 2);
      mesh.colors.push_back({static_cast<uint8_t>(std::lround(20 + 200 * x)), 0, 255});
    }
    return entry->second;
  };
  const auto is_hole = [](int i, int j) {
    return std::hypot(i - 12, j - 14) < 6.2 || std::max(std::abs(i - 29), std::abs(j - 26)) < 5;
  };
  for (int i = 0; i < kSide; ++i) {
    for (int j = 0; j < kSide; ++j) {
      if (is_hole(i, j)) continue;
      const uint32_t a = vertex(i, j);
      const uint32_t b = vertex(i + 1, j);
      const uint32_t c = vertex(i + 1, j + 1);
      const uint32_t d = vertex(i, j + 1);
      mesh.triangles.emplace_back(a, b, c);
      mesh.triangles.emplace_back(a, c, d);
    }
  }
  const double area = TopologyOf(mesh).area;
  for (const int64_t most : {1000, 300, 150}) {
    DecimateMesh(most, &mesh);
    EXPECT_LE(mesh.triangles.size(), static_cast<size_t>(most));
    const MeshTopology topology = TopologyOf(mesh);
    EXPECT_EQ(topology.euler_characteristic, -1);  // a disc with two holes
    EXPECT_EQ(topology.num_bad_edges, 0);
    double sum = 0;
    for (const Triangle& t : mesh.triangles) {
      const Eigen::Vector3d x = mesh.vertices[t[0]].cast<double>();
      const Eigen::Vector3d cross =
          (mesh.vertices[t[1]].cast<double>() - x).cross(mesh.vertices[t[2]].cast<double>() - x);
      EXPECT_GT(cross.z(), 0);
      sum += cross.z() / 2;
    }
    EXPECT_NEAR(sum, area, 0.02 * area);  // outlines become straight
    ASSERT_EQ(mesh.colors.size(), mesh.vertices.size());
    double worst = 0;
    for (size_t v = 0; v < mesh.vertices.size(); ++v) {
      worst = std::max(worst, std::abs(mesh.colors[v][0] - (20 + 200.0 * mesh.vertices[v].x())));
      EXPECT_EQ(mesh.vertices[v].z(), 2);
      EXPECT_EQ(mesh.colors[v][1], 0);
      EXPECT_EQ(mesh.colors[v][2], 255);
    }
    EXPECT_LT(worst, 8) << most;
  }
}

// A closed box of unit sides, each a grid of n x n squares.
TriangleMesh GridBox(int n) {
  TriangleMesh mesh;
  std::map<std::array<int, 3>, uint32_t> numbers;
  const auto vertex = [&](const std::array<int, 3>& at) {
    const auto [entry, is_new] = numbers.try_emplace(at, static_cast<uint32_t>(mesh.vertices.size()));
    if (is_new) {
      mesh.vertices.emplace_back(static_cast<float>(at[0]) / static_cast<float>(n),
                                 static_cast<float>(at[1]) / static_cast<float>(n),
                                 static_cast<float>(at[2]) / static_cast<float>(n));
    }
    return entry->second;
  };
  for (int axis = 0; axis < 3; ++axis) {
    for (const int side : {0, n}) {
      for (int i = 0; i < n; ++i) {
        for (int j = 0; j < n; ++j) {
          const auto corner = [&](int u, int v) {
            std::array<int, 3> at = {};
            at[axis] = side;
            at[(axis + 1) % 3] = i + u;
            at[(axis + 2) % 3] = j + v;
            return vertex(at);
          };
          const uint32_t a = corner(0, 0);
          const uint32_t b = side == 0 ? corner(0, 1) : corner(1, 0);
          const uint32_t c = corner(1, 1);
          const uint32_t d = side == 0 ? corner(1, 0) : corner(0, 1);
          mesh.triangles.emplace_back(a, b, c);
          mesh.triangles.emplace_back(a, c, d);
        }
      }
    }
  }
  return mesh;
}

// The largest distance of the vertices of one mesh to the triangles of another.
double LargestDistance(const TriangleMesh& from, const TriangleMesh& to) {
  std::vector<TriangleCorners> triangles;
  for (const Triangle& t : to.triangles) {
    triangles.push_back({to.vertices[t[0]].cast<double>(), to.vertices[t[1]].cast<double>(),
                         to.vertices[t[2]].cast<double>()});
  }
  const TriangleTree tree(std::move(triangles));
  double largest = 0;
  for (const Eigen::Vector3f& vertex : from.vertices) {
    largest = std::max(largest, tree.Distance(vertex.cast<double>()));
  }
  return largest;
}

TEST(MeshCleanup, ABoxNeedsFewTriangles) {
  const TriangleMesh full = GridBox(30);  // 10,800 triangles
  TriangleMesh mesh = full;
  SimplifyMesh(1e-3, &mesh);
  EXPECT_LE(mesh.triangles.size(), 60U);
  EXPECT_LT(LargestDistance(full, mesh), 2e-3);
  const MeshTopology topology = TopologyOf(mesh);
  EXPECT_EQ(topology.num_boundary_edges, 0);
  EXPECT_EQ(topology.euler_characteristic, 2);
  EXPECT_NEAR(topology.volume, 1, 3e-3);
}

// Triangles of side s on a sphere of radius 1 lie s^2 / 6 or so below it: their number goes with 1 / error.
TEST(MeshCleanup, SimplifiesABallToItsErrorBound) {
  const TriangleMesh full = Ball(5, 1);  // 20,480 triangles
  std::vector<size_t> counts;
  for (const double error : {0.002, 0.008}) {
    TriangleMesh mesh = full;
    SimplifyMesh(error, &mesh);
    EXPECT_LT(LargestDistance(full, mesh), 3 * error);
    EXPECT_LT(LargestDistance(mesh, full), 3 * error);
    EXPECT_EQ(TopologyOf(mesh).euler_characteristic, 2);
    counts.push_back(mesh.triangles.size());
  }
  EXPECT_LT(counts[0], full.triangles.size() / 4);
  EXPECT_NEAR(static_cast<double>(counts[0]) / static_cast<double>(counts[1]), 4, 1.5);
}

// However large the plane is that it stands on.
TEST(MeshCleanup, SimplifyingKeepsASmallDetail) {
  TriangleMesh mesh = GridBox(30);
  size_t peak = 0;
  for (size_t v = 0; v < mesh.vertices.size(); ++v) {
    const Eigen::Vector3f& x = mesh.vertices[v];
    if ((x - Eigen::Vector3f(0.5F, 0.5F, 1)).norm() < 1e-3F) peak = v;
  }
  mesh.vertices[peak].z() += 0.01F;
  const TriangleMesh full = mesh;
  SimplifyMesh(1e-3, &mesh);
  EXPECT_LT(mesh.triangles.size(), full.triangles.size() / 50);
  EXPECT_LT(LargestDistance(full, mesh), 3e-3);
  SimplifyMesh(0, &mesh);
  EXPECT_LT(LargestDistance(full, mesh), 3e-3);
}

TEST(MeshCleanup, FindsTheDiscUnderTheObject) {
  RandomNumbers random(7);
  TriangleMesh mesh = Plate(2, -0.3, 0.1);
  for (Eigen::Vector3f& vertex : mesh.vertices) vertex.z() += static_cast<float>(0.002 * random.Normal());
  Append(Ball(4, 0.8, {0.1, 0.2, 0.45}), &mesh);  // sinks 0.05 into the disc
  const std::optional<DiscSurface> disc = FindDisc(mesh);
  ASSERT_TRUE(disc.has_value());
  EXPECT_NEAR(disc->height, -0.3, 1e-3);
  EXPECT_LT(disc->sigma, 0.01);
  EXPECT_GT(disc->CutHeight(), -0.3);
  EXPECT_LT(disc->CutHeight(), -0.05);
  Reporter silent;
  MeshCleanupOptions options;
  options.remove_disc = true;
  const MeshCleanupSummary summary = CleanMesh(options, silent, &mesh);
  ASSERT_TRUE(summary.cut_height.has_value());
  EXPECT_EQ(summary.num_clusters_kept, 1);
  for (const Eigen::Vector3f& vertex : mesh.vertices) {
    EXPECT_GE(vertex.z(), *summary.cut_height - 1e-6);
    EXPECT_NEAR((vertex.cast<double>() - Eigen::Vector3d(0.1, 0.2, 0.45)).norm(), 0.8, 0.01);
  }
  // A cap is missing: the mesh ends in one outline.
  EXPECT_EQ(TopologyOf(mesh).euler_characteristic, 1);
}

// A scrap that hangs below the disc is level, too, but small.
TEST(MeshCleanup, AScrapBelowTheDiscIsNoDisc) {
  TriangleMesh mesh = Plate(2, -0.3, 0.1);
  Append(Ball(4, 0.8, {0.1, 0.2, 0.45}), &mesh);
  Append(Plate(0.3, -1, 0.1), &mesh);
  const std::optional<DiscSurface> disc = FindDisc(mesh);
  ASSERT_TRUE(disc.has_value());
  EXPECT_NEAR(disc->height, -0.3, 1e-3);
}

TEST(MeshCleanup, NoDiscNoCut) {
  TriangleMesh mesh = Ball(4, 1);
  // Its top is nearly level: a cap of 2.5 % of its area within the window would be taken for a disc.
  Reporter silent;
  MeshCleanupOptions options;
  options.remove_disc = true;
  EXPECT_FALSE(CleanMesh(options, silent, &mesh).cut_height.has_value());
  EXPECT_EQ(TopologyOf(mesh).euler_characteristic, 2);
  EXPECT_FALSE(FindDisc(TriangleMesh()).has_value());
}

// Turned and moved by any amount, the object is cut from what it stands on all the same.
TEST(MeshCleanup, FindsASupportThatLiesAskew) {
  const Eigen::Quaterniond rotation(Eigen::AngleAxisd(2.1, Eigen::Vector3d(0.3, -0.8, 0.5).normalized()));
  const Eigen::Vector3d translation(3, -2, 5);
  RandomNumbers random(7);
  TriangleMesh mesh = Plate(2, -0.3, 0.05);
  for (Eigen::Vector3f& vertex : mesh.vertices) vertex.z() += static_cast<float>(0.002 * random.Normal());
  Append(Ball(4, 0.8, {0.1, 0.2, 0.45}), &mesh);
  for (Eigen::Vector3f& vertex : mesh.vertices) {
    vertex = (rotation * vertex.cast<double>() + translation).cast<float>();
  }
  Reporter silent;
  MeshCleanupOptions options;
  options.remove_disc = true;
  options.is_axis_known = false;
  const MeshCleanupSummary summary = CleanMesh(options, silent, &mesh);
  ASSERT_TRUE(summary.cut_height.has_value());
  const Eigen::Vector3d up = rotation * Eigen::Vector3d::UnitZ();
  EXPECT_LT((summary.up - up).norm(), 3e-4);  // measured 7e-5
  EXPECT_GT(*summary.cut_height, -0.3 + up.dot(translation));
  EXPECT_LT(*summary.cut_height, -0.05 + up.dot(translation));
  const Eigen::Vector3d middle = rotation * Eigen::Vector3d(0.1, 0.2, 0.45) + translation;
  for (const Eigen::Vector3f& vertex : mesh.vertices) {
    EXPECT_NEAR((vertex.cast<double>() - middle).norm(), 0.8, 0.01);
  }
  EXPECT_EQ(TopologyOf(mesh).euler_characteristic, 1);
}

// What an object ends in is no support, and neither is a plane that nothing stands on.
TEST(MeshCleanup, NoSupportNoCut) {
  EXPECT_FALSE(FindSupportNormal(TriangleMesh()).has_value());
  EXPECT_FALSE(FindSupportNormal(Ball(4, 1)).has_value());
  EXPECT_FALSE(FindSupportNormal(Plate(2, 0, 0.1)).has_value());
  TriangleMesh solid = Plate(1, 1, 2);
  Append(Ball(4, 0.8), &solid);
  EXPECT_FALSE(FindSupportNormal(solid).has_value());
}

// Where the mesh lies does not matter, and neither does its unit.
TEST(MeshCleanup, ASupportIsFoundFarFromTheOrigin) {
  RandomNumbers random(7);
  TriangleMesh mesh = Plate(2, -0.3, 0.05);
  for (Eigen::Vector3f& vertex : mesh.vertices) vertex.z() += static_cast<float>(0.002 * random.Normal());
  Append(Ball(4, 0.8, {0.1, 0.2, 0.45}), &mesh);
  TriangleMesh solid = Plate(1, 1, 2);
  Append(Ball(4, 0.8), &solid);
  const auto moved = [](TriangleMesh copy, const Eigen::Vector3f& by, float scale) {
    for (Eigen::Vector3f& vertex : copy.vertices) vertex = scale * (vertex + by);
    return copy;
  };
  for (const Eigen::Vector3f& by :
       {Eigen::Vector3f(0, 0, 0), Eigen::Vector3f(40, -20, 30), Eigen::Vector3f(-30, 0, -60)}) {
    for (const float scale : {1.0F, 8.0F}) {
      const std::optional<Eigen::Vector3d> normal = FindSupportNormal(moved(mesh, by, scale));
      ASSERT_TRUE(normal) << by.transpose();
      EXPECT_LT((*normal - Eigen::Vector3d::UnitZ()).norm(), 1e-3) << by.transpose();
      EXPECT_FALSE(FindSupportNormal(moved(solid, by, scale))) << by.transpose();
    }
  }
}

TEST(MeshCleanup, CutsTrianglesInTwo) {
  TriangleMesh mesh = Ball(3, 1);
  mesh.normals = mesh.vertices;
  mesh.colors.resize(mesh.vertices.size());
  for (size_t i = 0; i < mesh.vertices.size(); ++i) {
    mesh.colors[i].setConstant(static_cast<uint8_t>(std::lround(100 + 100 * mesh.vertices[i].z())));
  }
  CutBelow(0.25, &mesh);
  const MeshTopology topology = TopologyOf(mesh);
  EXPECT_EQ(topology.num_bad_edges, 0);
  EXPECT_EQ(topology.euler_characteristic, 1);
  EXPECT_EQ(topology.num_components, 1);
  EXPECT_NEAR(topology.area, 2 * kPi * 0.75, 0.02 * 2 * kPi * 0.75);  // Archimedes: 2 pi r h
  for (size_t i = 0; i < mesh.vertices.size(); ++i) {
    EXPECT_GE(mesh.vertices[i].z(), 0.25F - 1e-6F);
    EXPECT_NEAR(mesh.normals[i].norm(), 1, 1e-5);
    EXPECT_NEAR(mesh.colors[i][0], 100 + 100 * mesh.vertices[i].z(), 1.1);
  }
}

// Triangles without an area, two corners of each in one place, have no plane that vertices could stay in.
TEST(MeshCleanup, DecimationStandsTrianglesWithoutAnArea) {
  TriangleMesh mesh = Ball(4, 1);
  const size_t before = mesh.triangles.size();
  for (size_t t = 0; t < before; t += 50) {
    const auto corners = mesh.triangles[t];
    mesh.vertices.push_back(mesh.vertices[corners[0]]);
    mesh.triangles.emplace_back(corners[0], corners[1], static_cast<uint32_t>(mesh.vertices.size() - 1));
  }
  DecimateMesh(1000, &mesh);
  EXPECT_LE(mesh.triangles.size(), 1200U);
  for (const auto& triangle : mesh.triangles) {
    for (int i = 0; i < 3; ++i) EXPECT_NEAR(mesh.vertices[triangle[i]].norm(), 1, 0.02);
  }
}

}  // namespace
}  // namespace s2gs
