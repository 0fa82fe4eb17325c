#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <vector>

#include "mesh/surface/part_sight.h"
#include "mesh/surface/table_top.h"
#include "mesh/surface/triangle_mesh.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

struct MeshCleanupOptions {
  /// Drop what lies below the table's top or beyond its rim, does not stand on it and is not the side of a
  /// body below it, where z is the axis.
  bool cut_at_table = true;
  bool remove_disc = false;  ///< cut the mesh just above the table's disc: the object alone stays.
  /// Whether z is the table's axis. Else the disc is the plane that the object stands on, whichever way it
  /// lies, and the largest cluster above it is the object: the others are its surroundings.
  bool is_axis_known = true;
  /// Clusters (parts that share no vertex) below this share of the largest one's area are dropped; 0 keeps
  /// all, 100 the largest alone [%]. By default what is a tenth as long stays, which photos may show without
  /// what joins it to the rest: the top of a vase above a dark neck.
  double min_cluster_area_pct = 1;
  int max_hole_edges = 0;        ///< holes with so many edges or fewer are closed; 0: none.
  int smoothing_iterations = 0;  ///< of Taubin's smoothing, which does not shrink.
  int64_t max_triangles = 0;     ///< the mesh is simplified to about this number; 0: it is not.

  OptionCheck Check() const;
};

/// What a clean-up did.
struct MeshCleanupSummary {
  std::optional<TableTop> table;     ///< nothing where none was looked for, or found.
  int64_t num_beside_table = 0;      ///< triangles dropped below and beside it.
  std::optional<double> cut_height;  ///< of the cut above the disc, along `up` from the object's origin.
  Eigen::Vector3d up = Eigen::Vector3d::UnitZ();  ///< of the disc, in the object's frame.
  int num_clusters = 0;                           ///< before.
  int num_clusters_kept = 0;
  int num_small_kept = 0;     ///< of these, small ones that are there.
  int num_large_dropped = 0;  ///< that are not there.
  int num_holes_closed = 0;
};

/// All steps in the order of the options, then normals again where vertices moved. Warns when there is no
/// disc to remove. \param judge  what photos say of clusters, where their areas do not decide alone
/// (min_cluster_area_pct is 0 or 100): of small ones those stay that are there, of others those go that are
/// not. Null: nothing.
MeshCleanupSummary CleanMesh(const MeshCleanupOptions& options, Reporter& reporter, TriangleMesh* mesh,
                             const PartJudge& judge = nullptr);

/// The same mesh with only the triangles whose flag is set and the vertices that these use, in their order.
/// Extra vertex properties are dropped.
void KeepTriangles(const std::vector<bool>& keep, TriangleMesh* mesh);

/// Which cluster each triangle belongs to, numbered from 0 in the order of their first triangles.
std::vector<int> ClusterOfTriangles(const TriangleMesh& mesh);

/// Keeps what lies above `height` along `up`. Triangles across it are cut; the cut stays open.
void CutBelow(double height, TriangleMesh* mesh, const Eigen::Vector3d& up = Eigen::Vector3d::UnitZ());

/// Vertices of a closed path along edges.
using MeshLoop = std::vector<uint32_t>;

/// The paths along the edges that only one triangle has, each in the direction in which that triangle walks.
std::vector<MeshLoop> FindHoles(const TriangleMesh& mesh);

/// Closes holes with at most `max_edges` edges by triangles between their vertices whose area is least
/// (Barequet and Sharir, "Filling gaps in the boundary of a polyhedron", 1995). \return  how many.
int CloseHoles(int max_edges, TriangleMesh* mesh);

/// Taubin, "A signal processing approach to fair surface design" (SIGGRAPH 1995), with equal weights: noise
/// goes, the volume stays. Vertices at holes stay where they are.
void SmoothMesh(int iterations, TriangleMesh* mesh);

}  // namespace s2gs
