#pragma once

#include <cstdint>
#include <vector>

#include "mesh/refine/refinement_photos.h"
#include "mesh/surface/triangle_mesh.h"

namespace s2gs {

/// The vertices of parts that stand by themselves over a table's top and that photos do not bear out: over
/// all of such a part they show no more in common than chance has. Of a single place that says little, and of
/// what floats over the top photos often show the top's own grain, so that most of its places are not
/// refuted; but a whole part has many places. The largest part is never among them, and where not even that
/// is borne out nothing is said of the others. Parts without texture are not judged.
/// \param mesh    with normals; z is the axis.
/// \param height  a little above the top, as in PartsAbove.
/// \return  one flag for each vertex. Throws Interrupted.
std::vector<uint8_t> FindPartsNotBorneOut(const RefinementPhotos& photos, const TriangleMesh& mesh,
                                          double height, int num_threads);

}  // namespace s2gs
