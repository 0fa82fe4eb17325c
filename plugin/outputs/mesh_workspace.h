#pragma once

#include <cstddef>
#include <filesystem>
#include <string>

#include "mesh/fusion/tsdf.h"
#include "mesh/refine/depth_outlines.h"
#include "mesh/refine/mesh_refinement.h"
#include "mesh/surface/mesh_cleanup.h"
#include "plugin/stage/workspace.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// How a workspace's depth maps become a mesh.
struct TsdfMesherOptions {
  std::filesystem::path output_path;     ///< empty: dense/0/meshed-tsdf.ply.
  std::filesystem::path mask_path;       ///< empty: dense/0/masks or, for photos without distortion, masks.
  std::string input_type = "geometric";  ///< of the maps' names: NAME.geometric.bin.
  bool use_normals = true;               ///< where there are normal maps.
  bool flatten_table = true;  ///< where photos showed the rim (gaussian_renderer's mask_log.jsonl).
  /// Photos before the background judge parts (parts_before_background.h).
  bool judge_by_background = true;
  bool move_to_outlines = true;  ///< to where the depth maps' outlines are (depth_outlines.h).
  TsdfOptions tsdf;
  MeshCleanupOptions cleanup;
  MeshRefinementOptions refinement;  ///< by the photos of dense/0.
  /// The finished mesh is simplified as far as SimplifyMesh's error stays below this [voxels]; 0: it is not.
  double max_error_voxels = 0.1;
};

struct TsdfMesherSummary {
  TsdfSummary tsdf;
  MeshCleanupSummary cleanup;
  DepthOutlineSummary outlines;
  MeshRefinementSummary refinement;
  std::filesystem::path output_path;
  int num_small_parts = 0;       ///< on the table, dropped.
  int num_images = 0;            ///< of the dense model.
  int num_depth_maps = 0;        ///< of these, with a depth map.
  int num_masks = 0;             ///< of these, with a mask.
  size_t num_full_vertices = 0;  ///< before the mesh was simplified.
  size_t num_vertices = 0;
  size_t num_triangles = 0;
  double fused_seconds = 0;  ///< wall time until the refinement began.
};

/// Fuses the depth maps of dense/0 in the frame of its model, which is the object's, cleans the mesh up,
/// refines it by the photos and writes it. Throws UserError when there are no depth maps, or nothing is left
/// of the mesh.
TsdfMesherSummary MeshWorkspace(const Workspace& workspace, const TsdfMesherOptions& options,
                                Reporter& reporter);

/// The workspace's mesh_log.jsonl: what the photos say of the mesh over time, as the training's log does.
void WriteMeshLog(const std::filesystem::path& path, const TsdfMesherSummary& summary,
                  const TsdfMesherOptions& options);

}  // namespace s2gs
