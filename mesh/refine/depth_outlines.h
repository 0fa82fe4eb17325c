#pragma once

#include <cstdint>
#include <optional>

#include "mesh/fusion/depth_view.h"
#include "mesh/surface/triangle_mesh.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// Moves a fused mesh to where the outlines of its depth maps are. Splats of a plain surface are discs as
/// large as its curvature lets them be; seen edge-on they reach beyond the place where they touch it, so that
/// training, which gets outlines right because photos show them, puts the discs behind the surface. Depths of
/// a view that looks at a disc's front lie as far behind, and fusion takes its surface from these. What the
/// views of the same place from the side have beyond the mesh's outline is the distance that is lost.
///
/// An outline is where depths jump from a surface to what is far behind it or to nothing, so that it is known
/// before the table and before other parts of the body, too. Each vertex on the mesh's outline in a view says
/// how far along its normal the view's own outline lies; these offsets become a smooth field over the mesh.

struct DepthOutlineSummary {
  int64_t num_vertices = 0;   ///< on an outline in some view.
  int64_t num_outlines = 0;   ///< of all vertices in all views.
  double mean_offset_px = 0;  ///< how far all vertices moved outwards, in pixels of the depth maps there.
  double rms_offset_px = 0;
};

/// Nothing moves where no vertex is on an outline. The result is bit-identical for any number of threads.
/// Throws what the source throws, and Interrupted. \param mesh  in the object's frame; its normals are
/// computed again. \param num_threads  0: one for each core.
/// \param table_height  a little above the top of a table across z, of which only the rim is an outline: what
/// is lower stays. Nothing: there is no table.
DepthOutlineSummary MoveToDepthOutlines(const DepthViewSource& views, std::optional<double> table_height,
                                        int num_threads, Reporter& reporter, TriangleMesh* mesh);

}  // namespace s2gs
