#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "mesh/surface/triangle_mesh.h"
#include "s2gs/image/image_file.h"

namespace s2gs {

/// A picture that triangles take their colours from.
struct TexturePage {
  Image8 image;  ///< RGB, sRGB as the photos are.
  /// Those of this page: `triangles[first_triangle]` and so many after it, which use no vertex of another
  /// page.
  uint64_t first_triangle = 0;
  uint64_t num_triangles = 0;
};

/// A mesh whose vertices each have one place in a page: along the borders of charts vertices stand once for
/// each chart.
struct TexturedMesh {
  std::vector<Eigen::Vector3f> vertices;  ///< in the frame and unit of the mesh that it comes from.
  std::vector<Eigen::Vector3f> normals;   ///< one per vertex.
  /// Where in its page's picture each vertex lies, as pixels are counted everywhere: the centre of the
  /// top-left one is (0.5, 0.5) [px].
  std::vector<Eigen::Vector2f> texels;
  std::vector<Triangle> triangles;  ///< sorted by page.
  std::vector<TexturePage> pages;
};

}  // namespace s2gs
