#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "mesh/refine/mesh_refinement.h"
#include "mesh/surface/triangle_mesh.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// Of these vertices, as far as photos see them: those at which photos show more texture than noise. Nothing
/// where photos see none of them. Some of the photos, evenly chosen, and some of the vertices are looked at.
/// Throws as RefineMesh. \param mesh  with normals.
std::optional<double> TexturedShare(const RefinementPhotoSource& photos,
                                    const std::vector<uint32_t>& vertices,
                                    const MeshRefinementOptions& options, const TriangleMesh& mesh,
                                    Reporter& reporter);

}  // namespace s2gs
