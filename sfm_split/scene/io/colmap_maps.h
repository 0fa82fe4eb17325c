#pragma once

#include <cstdint>
#include <filesystem>
#include <istream>
#include <ostream>
#include <vector>

namespace s2gs {

/// A map of floats as COLMAP keeps them in stereo/depth_maps and stereo/normal_maps: one depth per pixel
/// (0 where unknown, in the scene's unit, along the camera's z axis), or one unit normal per pixel in the
/// camera's frame (three channels).
///
/// COLMAP's dense programs take the column and row of a value as its image position, without the half pixel
/// to the pixel's centre: the value at (x, y) belongs to the ray through image position (x, y), where the
/// centre of the top-left pixel is (0.5, 0.5). Maps for stereo_fusion are rendered on those rays.
struct ColmapMap {
  int width = 0;              ///< [px]
  int height = 0;             ///< [px]
  int channels = 0;           ///< 1 depth, 3 normal.
  std::vector<float> values;  ///< channels * height * width: planar, rows from top to bottom.

  size_t Index(int x, int y, int channel) const {
    return (static_cast<size_t>(channel) * height + y) * width + x;
  }
  float At(int x, int y, int channel = 0) const { return values[Index(x, y, channel)]; }
  float& At(int x, int y, int channel = 0) { return values[Index(x, y, channel)]; }
};

/// Reads the text header `width&height&channels&` and the 32-bit floats after it. Throws UserError with the
/// path when the file is damaged, its size is not what the header promises, or it has other than `channels`
/// channels.
/// \param path  for the stream form: for messages only.
ColmapMap ReadColmapMap(const std::filesystem::path& path, int channels);
ColmapMap ReadColmapMap(std::istream& stream, const std::filesystem::path& path, int channels);

/// The path form is atomic.
void WriteColmapMap(const std::filesystem::path& path, const ColmapMap& map);
void WriteColmapMap(std::ostream& stream, const ColmapMap& map);

}  // namespace s2gs
