#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <vector>

#include "mesh/surface/triangle_mesh.h"

namespace s2gs {

/// The table's disc: the dominating horizontal surface (normal upwards), the lowest one when several are
/// nearly as large.
struct DiscSurface {
  double height = 0;     ///< mean height along `up` from the origin.
  double sigma = 0;      ///< standard deviation of its heights about the mean.
  double area = 0;       ///< of the mesh near that height.
  double mean_edge = 0;  ///< of the mesh there: its resolution.
  /// How far from the mean its own surface reaches: its roughness, and the rounding at its contact with the
  /// object.
  double Tolerance() const { return 3 * sigma + 1.5 * mean_edge; }
  double CutHeight() const { return height + Tolerance(); }
};
/// Nothing when no horizontal surface has 2 % of the mesh's area.
std::optional<DiscSurface> FindDisc(const TriangleMesh& mesh,
                                    const Eigen::Vector3d& up = Eigen::Vector3d::UnitZ());

/// The top of a table that turns about z: a horizontal plane that ends at a rim around the axis.
struct TableTop {
  DiscSurface disc;
  double radius = 0;  ///< of the rim, from the axis.
};

/// Of all horizontal surfaces with 2 % of the mesh's area, the one that the mesh bears out best. Inside the
/// rim of a table the surface lies on its plane or, as the object, above it; beyond the rim it does not. A
/// radius therefore scores the area within it that lies on the plane, less that which lies below and is as
/// level and as open to the top as a table is: undersides, and what hides inside the disc, are its own. The
/// rim is where the score is greatest, and the plane the one whose score is greatest there. Ledges and lids
/// have a body below them: within a table's rim more lies on the plane than below it, undersides left out,
/// and more above it than there are walls below and what the plane would hide. Where that holds for no plane
/// there is no table. A base that an upright side joins to a lower plane, which scores nearly as much, stands
/// on that. \param mesh  z is the axis.
std::optional<TableTop> FindTableTop(const TriangleMesh& mesh);

/// Which triangles belong to the table's top or to what stands on it. Of what lies below the plane, or on it
/// beyond the rim, only connected parts that are the side of a body do, upright all around the axis, so that
/// a plinth that passes for a table loses nothing; above it, connected parts whose centre of area is over the
/// table, where alone they can stand.
std::vector<bool> StandsOnTable(const TableTop& table, const TriangleMesh& mesh);

/// Drops the others. \return  how many triangles.
int64_t CutAtTable(const TableTop& table, TriangleMesh* mesh);

}  // namespace s2gs
