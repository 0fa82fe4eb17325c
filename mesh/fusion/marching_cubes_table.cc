#include <algorithm>
#include <vector>

#include "mesh/fusion/marching_cubes.h"
#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

// The edge between two neighbouring corners.
int EdgeBetween(int corner1, int corner2) {
  const int start = std::min(corner1, corner2);
  const int end = std::max(corner1, corner2);
  for (int edge = 0; edge < 12; ++edge) {
    if (EdgeStart(edge) == start && EdgeStart(edge) + (1 << (edge / 4)) == end) return edge;
  }
  return -1;
}

bool IsEdgeOnFace(int edge, int axis, int side) {
  const int start = EdgeStart(edge);
  const int end = start + (1 << (edge / 4));
  return (start >> axis & 1) == side && (end >> axis & 1) == side;
}

bool OnOneFace(int edge1, int edge2) {
  for (int axis = 0; axis < 3; ++axis) {
    for (int side = 0; side < 2; ++side) {
      if (IsEdgeOnFace(edge1, axis, side) && IsEdgeOnFace(edge2, axis, side)) return true;
    }
  }
  return false;
}

// Corners of a face, counter-clockwise seen from outside of the cube.
std::array<int, 4> FaceCorners(int axis, int side) {
  const int u = 1 << ((axis + 1) % 3);
  const int v = 1 << ((axis + 2) % 3);
  const int base = side << axis;
  if (side == 1) return {base, base + u, base + u + v, base + v};
  return {base, base + v, base + u + v, base + u};
}

// Splits a polygon into triangles so that no diagonal lies in a face of the cube, where the neighbouring
// cube could have the same one. Returns false when there is no such way.
bool Triangulate(const std::vector<int>& polygon, std::vector<std::array<int, 3>>* triangles) {
  const auto n = static_cast<int>(polygon.size());
  if (n == 3) {
    triangles->push_back({polygon[0], polygon[1], polygon[2]});
    return true;
  }
  for (int i = 0; i < n; ++i) {
    const int before = polygon[(i + n - 1) % n];
    const int after = polygon[(i + 1) % n];
    if (OnOneFace(before, after)) continue;
    std::vector<int> rest = polygon;
    rest.erase(rest.begin() + i);
    const size_t count = triangles->size();
    triangles->push_back({before, polygon[i], after});
    if (Triangulate(rest, triangles)) return true;
    triangles->resize(count);
  }
  return false;
}

// The surface meets each face in segments that cut off the inside corners, one segment for each run of them:
// on faces with two opposite inside corners these stay apart. The rule knows only the face, so both cubes of
// a face agree. A segment goes from where the walk around the face entered the inside to where it leaves it.
// Two faces walk along an edge in opposite directions, so each crossed edge ends one segment and begins one:
// the segments are closed polygons.
MarchingCubesCase MakeCase(int inside) {
  std::array<int, 12> next{};
  next.fill(-1);
  for (int axis = 0; axis < 3; ++axis) {
    for (int side = 0; side < 2; ++side) {
      const std::array<int, 4> corners = FaceCorners(axis, side);
      const auto is_inside = [&](int i) { return (inside >> corners[i & 3] & 1) != 0; };
      for (int i = 0; i < 4; ++i) {
        if (!is_inside(i) || is_inside(i + 1)) continue;  // not where the walk leaves the inside
        int entry = i;
        while (is_inside(entry - 1 + 4)) --entry;
        const int left = EdgeBetween(corners[i], corners[(i + 1) & 3]);
        const int entered = EdgeBetween(corners[entry & 3], corners[(entry + 3) & 3]);
        next[entered] = left;
      }
    }
  }
  MarchingCubesCase result;
  std::vector<std::array<int, 3>> triangles;
  for (int first = 0; first < 12; ++first) {
    if (next[first] < 0) continue;
    std::vector<int> polygon;
    for (int edge = first; next[edge] >= 0;) {
      polygon.push_back(edge);
      const int after = next[edge];
      next[edge] = -1;
      edge = after;
    }
    S2GS_INVARIANT(Triangulate(polygon, &triangles));
  }
  result.num_triangles = static_cast<int>(triangles.size());
  S2GS_INVARIANT(3 * triangles.size() <= result.edges.size());
  size_t i = 0;
  for (const std::array<int, 3>& triangle : triangles) {
    for (const int edge : triangle) result.edges[i++] = static_cast<uint8_t>(edge);
  }
  return result;
}

}  // namespace

const std::array<MarchingCubesCase, 256>& MarchingCubesTable() {
  static const std::array<MarchingCubesCase, 256> table = [] {
    std::array<MarchingCubesCase, 256> cases;
    for (int inside = 0; inside < 256; ++inside) cases[inside] = MakeCase(inside);
    return cases;
  }();
  return table;
}

}  // namespace s2gs
