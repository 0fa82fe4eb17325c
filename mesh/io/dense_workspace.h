#pragma once

#include <filesystem>

#include "sfm_split/base/reporter.h"
#include "sfm_split/scene/io/colmap_model.h"

namespace s2gs {

/// Where a dense workspace's photos and masks come from.
struct DenseWorkspaceSource {
  std::filesystem::path model;   ///< the model's folder, for messages.
  std::filesystem::path images;  ///< photos by the names of the model's images.
  std::filesystem::path masks;   ///< NAME.png; may be empty, missing, or lack some.
  std::filesystem::path root{};  ///< that nothing is written outside of; empty: the dense workspace itself.
  bool resample_always = false;  ///< photos without distortion are resampled too, not copied.
};

/// Writes `folder` as `colmap image_undistorter` leaves it: images without distortion, sparse, and stereo
/// with empty depth_maps, normal_maps and consistency_graphs, patch-match.cfg and fusion.cfg; besides, masks
/// that fit those images. Depth and normal maps that are there already stay. Photos of cameras without
/// distortion are copied byte by byte. \return  the model as written: all cameras are PINHOLE. Throws
/// UserError when a photo is missing, its size is not its camera's, or a file would replace it, and
/// Interrupted.
ColmapModel WriteDenseWorkspace(const std::filesystem::path& folder, const ColmapModel& model,
                                const DenseWorkspaceSource& source, Reporter& reporter);

}  // namespace s2gs
