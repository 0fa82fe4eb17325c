#include "mesh/fusion/marching_cubes.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "mesh/surface/vertex_normals.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {
namespace {

constexpr int kWindow = kBlockSide + 1;
constexpr int kWindowVoxels = kWindow * kWindow * kWindow;
// Vertices keep this share of an edge away from the voxels, so that no triangle loses its area.
constexpr float kEnd = 1e-3F;

// A block's values and those of the next voxels in each direction. What was not seen is NaN.
struct Window {
  std::array<float, kWindowVoxels> values;
  // Indices of the blocks at (0 or 1, 0 or 1, 0 or 1) from this one.
  std::array<int, 8> blocks;

  static int Index(int x, int y, int z) { return (z * kWindow + y) * kWindow + x; }
};

int VoxelIndex(int x, int y, int z) { return (z * kBlockSide + y) * kBlockSide + x; }

// Vertices lie on the edges that go from a voxel in the positive directions; each voxel owns three edges.
// Vertices of a block are numbered by voxel, then axis.
struct BlockVertices {
  std::array<uint8_t, kBlockVoxels> axes{};     // bit a: the edge along axis a has a vertex
  std::array<uint16_t, kBlockVoxels> before{};  // vertices of the voxels before this one
  uint32_t first = 0;                           // the block's first vertex in the mesh
  uint32_t count = 0;
  uint32_t num_triangles = 0;

  uint32_t Vertex(int voxel, int axis) const {
    // Bits below the axis; of two bits, each counts one.
    const unsigned lower = axes[voxel] & ((1U << static_cast<unsigned>(axis)) - 1);
    return first + before[voxel] + (lower & 1U) + (lower >> 1U);
  }
};

class Extractor {
 public:
  Extractor(const TsdfVolume& volume, int num_threads)
      : volume_(volume),
        num_threads_(num_threads),
        num_blocks_(volume.blocks.size()),
        vertices_(num_blocks_) {}

  TriangleMesh Extract() {
    ForEachBlock([this](int b, const Window& window) { Count(window, &vertices_[b]); });
    uint64_t num_vertices = 0;
    uint64_t num_triangles = 0;
    std::vector<uint64_t> first_triangles(num_blocks_);
    for (int b = 0; b < num_blocks_; ++b) {
      vertices_[b].first = static_cast<uint32_t>(num_vertices);
      first_triangles[b] = num_triangles;
      num_vertices += vertices_[b].count;
      num_triangles += vertices_[b].num_triangles;
    }
    if (num_vertices > std::numeric_limits<uint32_t>::max()) {
      throw UserError("The mesh would have more than 2^32 vertices: choose a larger voxel_size");
    }
    mesh_.vertices.resize(num_vertices);
    mesh_.triangles.resize(num_triangles);
    ForEachBlock([&](int b, const Window& window) {
      PlaceVertices(b, window);
      PlaceTriangles(window, first_triangles[b]);
    });
    vertices_ = {};
    DropUnused();
    return std::move(mesh_);
  }

 private:
  template <typename Work>
  void ForEachBlock(const Work& work) const {
    ParallelFor(num_blocks_, num_threads_, 16, [&](int64_t b) {
      Window window;
      Load(static_cast<int>(b), &window);
      work(static_cast<int>(b), window);
    });
  }

  void Load(int b, Window* window) const {
    const Eigen::Vector3i block = volume_.blocks.Block(b);
    window->blocks[0] = b;
    for (int i = 1; i < 8; ++i) {
      window->blocks[i] = volume_.blocks.Find(block + Eigen::Vector3i(i & 1, i >> 1 & 1, i >> 2));
    }
    for (int i = 0; i < 8; ++i) {
      const int size_x = (i & 1) != 0 ? 1 : kBlockSide;
      const int size_y = (i >> 1 & 1) != 0 ? 1 : kBlockSide;
      const int size_z = (i >> 2) != 0 ? 1 : kBlockSide;
      const int x0 = (i & 1) * kBlockSide;
      const int y0 = (i >> 1 & 1) * kBlockSide;
      const int z0 = (i >> 2) * kBlockSide;
      const size_t first = static_cast<size_t>(std::max(window->blocks[i], 0)) * kBlockVoxels;
      for (int z = 0; z < size_z; ++z) {
        for (int y = 0; y < size_y; ++y) {
          float* row = &window->values[Window::Index(x0, y0 + y, z0 + z)];
          if (window->blocks[i] == TsdfBlockIndex::kNone) {
            std::fill(row, row + size_x, std::numeric_limits<float>::quiet_NaN());
            continue;
          }
          const size_t begin = first + VoxelIndex(0, y, z);
          for (int x = 0; x < size_x; ++x) {
            row[x] = volume_.weights[begin + x] > 0 ? volume_.distances[begin + x]
                                                    : std::numeric_limits<float>::quiet_NaN();
          }
        }
      }
    }
  }

  static bool IsCrossed(float value1, float value2) {
    // NaN is neither.
    return (value1 < 0 && value2 >= 0) || (value1 >= 0 && value2 < 0);
  }

  // Which corners of a cell are inside, or -1 when one was not seen.
  static int CaseOf(const Window& window, int x, int y, int z) {
    int inside = 0;
    for (int corner = 0; corner < 8; ++corner) {
      const float value =
          window.values[Window::Index(x + (corner & 1), y + (corner >> 1 & 1), z + (corner >> 2))];
      if (std::isnan(value)) return -1;
      inside |= (value < 0 ? 1 : 0) << corner;
    }
    return inside;
  }

  template <typename Work>
  static void ForEachVoxel(const Work& work) {
    for (int z = 0; z < kBlockSide; ++z) {
      for (int y = 0; y < kBlockSide; ++y) {
        for (int x = 0; x < kBlockSide; ++x) work(x, y, z);
      }
    }
  }

  static float Neighbour(const Window& window, int x, int y, int z, int axis) {
    return window
        .values[Window::Index(x + (axis == 0 ? 1 : 0), y + (axis == 1 ? 1 : 0), z + (axis == 2 ? 1 : 0))];
  }

  static void Count(const Window& window, BlockVertices* vertices) {
    const auto& table = MarchingCubesTable();
    ForEachVoxel([&](int x, int y, int z) {
      const int voxel = VoxelIndex(x, y, z);
      vertices->before[voxel] = static_cast<uint16_t>(vertices->count);
      const float value = window.values[Window::Index(x, y, z)];
      for (int axis = 0; axis < 3; ++axis) {
        if (!IsCrossed(value, Neighbour(window, x, y, z, axis))) continue;
        vertices->axes[voxel] =
            static_cast<uint8_t>(vertices->axes[voxel] | 1U << static_cast<unsigned>(axis));
        ++vertices->count;
      }
      const int inside = CaseOf(window, x, y, z);
      if (inside > 0) vertices->num_triangles += static_cast<uint32_t>(table[inside].num_triangles);
    });
  }

  void PlaceVertices(int b, const Window& window) {
    const Eigen::Vector3d first = (kBlockSide * volume_.blocks.Block(b)).cast<double>();
    const BlockVertices& vertices = vertices_[b];
    if (vertices.count == 0) return;
    uint32_t vertex = vertices.first;
    ForEachVoxel([&](int x, int y, int z) {
      const uint8_t axes = vertices.axes[VoxelIndex(x, y, z)];
      if (axes == 0) return;
      const float value = window.values[Window::Index(x, y, z)];
      for (int axis = 0; axis < 3; ++axis) {
        if ((axes >> axis & 1) == 0) continue;
        const float share = value / (value - Neighbour(window, x, y, z, axis));
        Eigen::Vector3d position = first + Eigen::Vector3d(x, y, z);
        position[axis] += std::clamp(share, kEnd, 1 - kEnd);
        mesh_.vertices[vertex++] = (volume_.origin + volume_.voxel_size * position).cast<float>();
      }
    });
  }

  void PlaceTriangles(const Window& window, uint64_t first_triangle) {
    if (vertices_[window.blocks[0]].num_triangles == 0) return;
    const auto& table = MarchingCubesTable();
    Triangle* triangle = &mesh_.triangles[first_triangle];
    ForEachVoxel([&](int x, int y, int z) {
      const int inside = CaseOf(window, x, y, z);
      if (inside <= 0 || inside == 255) return;
      const MarchingCubesCase& cube = table[inside];
      for (int t = 0; t < cube.num_triangles; ++t) {
        for (int i = 0; i < 3; ++i) {
          const int edge = cube.edges[3 * t + i];
          const int start = EdgeStart(edge);
          const int vx = x + (start & 1);
          const int vy = y + (start >> 1 & 1);
          const int vz = z + (start >> 2);
          const int block = window.blocks[vx / kBlockSide | vy / kBlockSide << 1 | vz / kBlockSide << 2];
          (*triangle)[i] = vertices_[block].Vertex(
              VoxelIndex(vx % kBlockSide, vy % kBlockSide, vz % kBlockSide), edge / 4);
        }
        ++triangle;
      }
    });
  }

  // Edges between seen voxels may have a vertex that no wholly seen cell uses.
  void DropUnused() {
    constexpr uint32_t kUnused = std::numeric_limits<uint32_t>::max();
    std::vector<uint32_t> places(mesh_.vertices.size(), kUnused);
    for (const Triangle& triangle : mesh_.triangles) {
      for (int i = 0; i < 3; ++i) places[triangle[i]] = 0;
    }
    uint32_t count = 0;
    for (size_t i = 0; i < places.size(); ++i) {
      if (places[i] == kUnused) continue;
      mesh_.vertices[count] = mesh_.vertices[i];
      places[i] = count++;
    }
    mesh_.vertices.resize(count);
    for (Triangle& triangle : mesh_.triangles) {
      for (int i = 0; i < 3; ++i) triangle[i] = places[triangle[i]];
    }
  }

  const TsdfVolume& volume_;
  const int num_threads_;
  const int num_blocks_;
  std::vector<BlockVertices> vertices_;
  TriangleMesh mesh_;
};

}  // namespace

TriangleMesh MarchingCubes(const TsdfVolume& volume, int num_threads) {
  S2GS_INVARIANT(volume.distances.size() == volume.weights.size());
  S2GS_INVARIANT(volume.distances.size() == static_cast<size_t>(volume.blocks.size()) * kBlockVoxels);
  TriangleMesh mesh = Extractor(volume, num_threads).Extract();
  ComputeNormals(&mesh);
  return mesh;
}

}  // namespace s2gs
