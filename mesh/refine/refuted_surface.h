#pragma once

#include <cstdint>
#include <vector>

#include "mesh/refine/offset_field.h"
#include "mesh/refine/refinement_photos.h"
#include "mesh/surface/triangle_mesh.h"

namespace s2gs {

/// The vertices where hardly two photos show the same: webs that training spans between parts of a body and
/// over hollows, at a depth that no photos bear out and that hides the one they would. Compared are all
/// photos that see a vertex with each other, so that neighbours on the turn are among them: on a true surface
/// these agree where highlights and shadows move over it, too.
/// \param graph  of the mesh.
/// \param mesh   with normals.
/// \return  one flag for each vertex: most of its surroundings are refuted. Where photos show no texture, or
///          only one sees the surface, they refute nothing. Throws Interrupted.
std::vector<uint8_t> FindRefuted(const RefinementPhotos& photos, const VertexGraph& graph,
                                 const TriangleMesh& mesh, int num_threads);

}  // namespace s2gs
