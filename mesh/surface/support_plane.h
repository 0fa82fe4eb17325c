#pragma once

#include <Eigen/Core>
#include <optional>

#include "mesh/surface/triangle_mesh.h"

namespace s2gs {

/// The normal, away from what lies beneath, of the plane that an object stands on, found without knowing
/// where up is: the plane with the largest area that faces its way, found by random sampling (Fischler and
/// Bolles, "Random sample consensus", 1981). It counts when it has a tenth of the mesh's area, at most a
/// fifth lies beneath it, as it would beneath the side of an object, and a twentieth or more above.
std::optional<Eigen::Vector3d> FindSupportNormal(const TriangleMesh& mesh);

}  // namespace s2gs
