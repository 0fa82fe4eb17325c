#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <istream>
#include <ostream>
#include <vector>

namespace s2gs {

/// Which images see each point of a fused cloud: point i is seen by image_indices[begins[i] .. begins[i+1]).
/// The indices count the images of the dense workspace's model in the order of its images file.
struct ColmapVisibility {
  std::vector<uint64_t> begins = {0};  ///< number of points + 1.
  std::vector<uint32_t> image_indices;
};

/// What COLMAP's stereo_fusion writes: fused.ply and, beside it, fused.ply.vis.
struct ColmapFusedCloud {
  std::vector<Eigen::Vector3f> points;               ///< in the frame of the dense workspace's model.
  std::vector<Eigen::Vector3f> normals;              ///< one per point, of unit length.
  std::vector<Eigen::Matrix<uint8_t, 3, 1>> colors;  ///< RGB, one per point.
  ColmapVisibility visibility;                       ///< one entry per point.
};

/// Reads `path` and `path`.vis, both needed. Throws UserError with the path when one is missing or damaged,
/// a point is not finite, or the two disagree on the number of points.
ColmapFusedCloud ReadColmapFusedCloud(const std::filesystem::path& path);

/// Writes `path` (binary little-endian) and `path`.vis, each atomically, the visibility first.
void WriteColmapFusedCloud(const std::filesystem::path& path, const ColmapFusedCloud& cloud);

/// The visibility alone. \param path  for messages only.
ColmapVisibility ReadColmapVisibility(std::istream& stream, const std::filesystem::path& path);
void WriteColmapVisibility(std::ostream& stream, const ColmapVisibility& visibility);

}  // namespace s2gs
