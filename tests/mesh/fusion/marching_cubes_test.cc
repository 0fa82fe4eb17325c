#include "mesh/fusion/marching_cubes.h"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <functional>
#include <vector>

#include "tests/mesh/surface/mesh_topology.h"
#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

// A cube of blocks around the origin block, filled by a function of the voxel's coordinates.
TsdfVolume FilledVolume(int blocks_per_side, const std::function<float(const Eigen::Vector3i&)>& field) {
  std::vector<uint64_t> keys;
  for (int z = 0; z < blocks_per_side; ++z) {
    for (int y = 0; y < blocks_per_side; ++y) {
      for (int x = 0; x < blocks_per_side; ++x) {
        keys.push_back(TsdfBlockIndex::BlockKey(Eigen::Vector3i(x, y, z).array() - 1));
      }
    }
  }
  std::sort(keys.begin(), keys.end());
  TsdfVolume volume;
  volume.voxel_size = 0.5;
  volume.origin = {1, 2, 3};
  volume.truncation = 2;
  volume.blocks = TsdfBlockIndex(keys);
  volume.weights.assign(keys.size() * kBlockVoxels, 1);
  volume.distances.resize(keys.size() * kBlockVoxels);
  for (int b = 0; b < volume.blocks.size(); ++b) {
    for (int i = 0; i < kBlockVoxels; ++i) {
      const Eigen::Vector3i voxel =
          kBlockSide * volume.blocks.Block(b) + Eigen::Vector3i(i & 7, i >> 3 & 7, i >> 6);
      volume.distances[static_cast<size_t>(b) * kBlockVoxels + i] = field(voxel);
    }
  }
  return volume;
}

bool IsOnBorder(const Eigen::Vector3i& voxel, int blocks_per_side) {
  return (voxel.array() == -kBlockSide).any() ||
         (voxel.array() == kBlockSide * (blocks_per_side - 1) - 1).any();
}

TEST(TsdfBlockIndex, KeysAndLookUp) {
  RandomNumbers random(1);
  std::vector<uint64_t> keys;
  std::vector<Eigen::Vector3i> blocks;
  for (int i = 0; i < 1000; ++i) {
    Eigen::Vector3i block;
    for (int axis = 0; axis < 3; ++axis) {
      const int reach = i % 2 == 0 ? 4 : TsdfBlockIndex::kMaxCoordinate;
      block[axis] = static_cast<int>(random.Index(2 * static_cast<size_t>(reach) + 1)) - reach;
    }
    EXPECT_EQ(TsdfBlockIndex::BlockOfKey(TsdfBlockIndex::BlockKey(block)), block);
    keys.push_back(TsdfBlockIndex::BlockKey(block));
    blocks.push_back(block);
  }
  std::sort(keys.begin(), keys.end());
  keys.erase(std::unique(keys.begin(), keys.end()), keys.end());
  const TsdfBlockIndex index(keys);
  EXPECT_EQ(index.size(), static_cast<int>(keys.size()));
  for (const Eigen::Vector3i& block : blocks) {
    const int place = index.Find(block);
    ASSERT_NE(place, TsdfBlockIndex::kNone);
    EXPECT_EQ(index.Block(place), block);
  }
  // The farthest blocks either way.
  constexpr int kFarthest = TsdfBlockIndex::kMaxCoordinate;
  for (int corner = 0; corner < 8; ++corner) {
    const Eigen::Vector3i block((corner & 1) != 0 ? kFarthest : -kFarthest,
                                (corner & 2) != 0 ? kFarthest : -kFarthest,
                                (corner & 4) != 0 ? kFarthest : -kFarthest);
    EXPECT_EQ(TsdfBlockIndex::BlockOfKey(TsdfBlockIndex::BlockKey(block)), block);
    EXPECT_EQ(TsdfBlockIndex({TsdfBlockIndex::BlockKey(block)}).Find(block), 0);
  }
  EXPECT_EQ(index.Find({100, 100, 100}), TsdfBlockIndex::kNone);
  EXPECT_EQ(index.Find({1 << 30, 0, 0}), TsdfBlockIndex::kNone);
  EXPECT_EQ(TsdfBlockIndex().Find({0, 0, 0}), TsdfBlockIndex::kNone);
}

// In each case the triangles use exactly the edges between an inside and an outside corner.
TEST(MarchingCubes, TableUsesTheCrossedEdges) {
  for (int inside = 0; inside < 256; ++inside) {
    const MarchingCubesCase& cube = MarchingCubesTable()[inside];
    unsigned used = 0;
    for (int i = 0; i < 3 * cube.num_triangles; ++i) used |= 1U << cube.edges[i];
    unsigned crossed = 0;
    for (int edge = 0; edge < 12; ++edge) {
      const int start = EdgeStart(edge);
      const int end = start + (1 << (edge / 4));
      if ((inside >> start & 1) != (inside >> end & 1)) crossed |= 1U << edge;
    }
    EXPECT_EQ(used, crossed) << inside;
  }
}

// White noise meets all cases and all pairs of neighbours.
TEST(MarchingCubes, RandomFieldsAreWatertight) {
  for (uint64_t seed = 0; seed < 5; ++seed) {
    RandomNumbers random(seed);
    const TsdfVolume volume = FilledVolume(3, [&](const Eigen::Vector3i& voxel) {
      const double value = random.Uniform(-1, 1);
      // Zeros and values that round to them must not open cracks either.
      const double special = random.Uniform() < 0.1 ? (random.Uniform() < 0.5 ? 0.0 : 1e-30) : value;
      return IsOnBorder(voxel, 3) ? 1.0F : static_cast<float>(special);
    });
    const TriangleMesh mesh = MarchingCubes(volume, 2);
    const MeshTopology topology = TopologyOf(mesh);
    EXPECT_GT(mesh.triangles.size(), 10000u);
    EXPECT_EQ(topology.num_boundary_edges, 0);
    EXPECT_EQ(topology.num_bad_edges, 0);
    EXPECT_EQ(topology.num_degenerate_triangles, 0);
    EXPECT_EQ(topology.num_unused_vertices, 0);
    EXPECT_GT(topology.volume, 0) << topology.area;
  }
}

double Bumpy(const Eigen::Vector3d& x) {
  return (x - Eigen::Vector3d(3.3, 4.1, 4.7)).norm() - 6 +
         0.8 * std::sin(1.1 * x.x()) * std::cos(0.9 * x.y());
}

TEST(MarchingCubes, VerticesLieOnTheSurfaceAndNormalsPointOutwards) {
  const TsdfVolume volume = FilledVolume(
      3, [](const Eigen::Vector3i& voxel) { return static_cast<float>(Bumpy(voxel.cast<double>())); });
  const TriangleMesh mesh = MarchingCubes(volume, 1);
  const MeshTopology topology = TopologyOf(mesh);
  EXPECT_EQ(topology.num_boundary_edges, 0);
  EXPECT_EQ(topology.num_bad_edges, 0);
  EXPECT_EQ(topology.num_components, 1);
  EXPECT_EQ(topology.euler_characteristic, 2);
  double worst = 0;
  double worst_cosine = 1;
  for (size_t i = 0; i < mesh.vertices.size(); ++i) {
    const Eigen::Vector3d x = (mesh.vertices[i].cast<double>() - volume.origin) / volume.voxel_size;
    worst = std::max(worst, std::abs(Bumpy(x)));
    Eigen::Vector3d gradient;
    for (int axis = 0; axis < 3; ++axis) {
      const Eigen::Vector3d step = 1e-4 * Eigen::Vector3d::Unit(axis);
      gradient[axis] = Bumpy(x + step) - Bumpy(x - step);
    }
    worst_cosine = std::min(worst_cosine, mesh.normals[i].cast<double>().dot(gradient.normalized()));
  }
  EXPECT_LT(worst, 0.16);        // measured 0.11: linear interpolation of a curved field [voxels]
  EXPECT_GT(worst_cosine, 0.6);  // measured 0.67: slivers on a sphere of six voxels
}

TEST(MarchingCubes, StopsWhereTheFieldIsUnknown) {
  TsdfVolume volume =
      FilledVolume(3, [](const Eigen::Vector3i& voxel) { return static_cast<float>(voxel.z()) - 3.5F; });
  const auto unknown = [](const Eigen::Vector3i& voxel) { return voxel.x() > 5; };
  for (int b = 0; b < volume.blocks.size(); ++b) {
    for (int i = 0; i < kBlockVoxels; ++i) {
      const Eigen::Vector3i voxel =
          kBlockSide * volume.blocks.Block(b) + Eigen::Vector3i(i & 7, i >> 3 & 7, i >> 6);
      const size_t place = static_cast<size_t>(b) * kBlockVoxels + i;
      if (unknown(voxel)) {
        volume.weights[place] = 0;
        volume.distances[place] = -1;  // must not be looked at
      }
    }
  }
  const TriangleMesh mesh = MarchingCubes(volume, 1);
  // Cells from -8 to 5 and -8 to 15 of unit area, times the voxel's.
  EXPECT_NEAR(TopologyOf(mesh).area, 13 * 23 * 0.25, 1e-3);
  EXPECT_EQ(TopologyOf(mesh).num_unused_vertices, 0);
  for (const Eigen::Vector3f& vertex : mesh.vertices) {
    EXPECT_LE(vertex.x(), 1 + 0.5 * 5);
    EXPECT_NEAR(vertex.z(), 3 + 0.5 * 3.5, 1e-6);
  }
  for (const Eigen::Vector3f& normal : mesh.normals) EXPECT_NEAR(normal.z(), 1, 1e-6);
}

TEST(MarchingCubes, SameForAnyNumberOfThreads) {
  const TsdfVolume volume = FilledVolume(
      4, [](const Eigen::Vector3i& voxel) { return static_cast<float>(Bumpy(voxel.cast<double>())); });
  const TriangleMesh one = MarchingCubes(volume, 1);
  for (const int num_threads : {2, 3, 7}) {
    const TriangleMesh many = MarchingCubes(volume, num_threads);
    EXPECT_EQ(one.vertices, many.vertices);
    EXPECT_EQ(one.normals, many.normals);
    EXPECT_EQ(one.triangles, many.triangles);
  }
}

TEST(MarchingCubes, EmptyVolume) {
  const TriangleMesh mesh = MarchingCubes(TsdfVolume(), 2);
  EXPECT_TRUE(mesh.vertices.empty());
  EXPECT_TRUE(mesh.triangles.empty());
}

}  // namespace
}  // namespace s2gs
