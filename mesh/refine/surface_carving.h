#pragma once

#include <cstdint>
#include <vector>

#include "mesh/refine/offset_field.h"
#include "mesh/refine/refinement_photos.h"
#include "mesh/surface/triangle_mesh.h"

namespace s2gs {

/// Opens hollows that training filled. Splats close deep and narrow places that few photos look into, some
/// pixels in front of their floor, which is further than the passes of the refinement search. There photos
/// see texture and contradict each other: what they show is no more alike than chance makes it. Such parts of
/// the surface sink, a pixel at a time, until photos agree (Kutulakos and Seitz, "A theory of shape by space
/// carving", 2000). A part that has not found agreement at its end is put back: moving shadows and highlights
/// contradict each other on the true surface, too, and at any depth.
/// \param graph      of the mesh.
/// \param num_views  photos in which a vertex is compared.
/// \param mesh       with normals, which are computed again.
/// \return  the vertices that lie deeper, in no order; none: nothing has changed. Throws Interrupted.
std::vector<uint32_t> CarveContradicted(const RefinementPhotos& photos, const VertexGraph& graph,
                                        int num_views, int num_threads, TriangleMesh* mesh);

}  // namespace s2gs
