#pragma once

#include <optional>

#include "mesh/refine/mesh_refinement.h"
#include "mesh/surface/table_plane.h"
#include "mesh/surface/triangle_mesh.h"
#include "plugin/stage/workspace.h"
#include "sfm_split/base/reporter.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

/// A table's top as gaussian_renderer found it.
struct KnownTop {
  TablePlane plane;
  bool is_seen = false;   ///< where photos show it is known.
  bool is_plane = false;  ///< by its texture, photos show that.
};

/// From the workspace's mask_log.jsonl; nothing where no rim was found, or the axis is not z.
std::optional<KnownTop> ReadTop(const Workspace& workspace, const TurntableAxis& axis,
                                const RefinementPhotoSource& photos);

/// Moves what leads level from the rim of a top inwards to the top's plane.
void FlattenTop(const TablePlane& plane, TriangleMesh* mesh);

/// The same where photos see no texture on the top, which would tell its shape, or its texture shows that it
/// is the plane. \return  whether it was made its plane.
bool FlattenTable(const KnownTop& known, const RefinementPhotoSource& photos,
                  const MeshRefinementOptions& options, Reporter& reporter, TriangleMesh* mesh);

}  // namespace s2gs
