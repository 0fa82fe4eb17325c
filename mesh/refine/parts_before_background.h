#pragma once

#include <vector>

#include "mesh/refine/mesh_refinement.h"
#include "mesh/surface/part_sight.h"
#include "mesh/surface/triangle_mesh.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// Parts of a mesh that photos of cameras that stand still show by themselves, with nothing but the
/// background behind them. What the background looks like at a pixel is known there from the photos in which
/// nothing of the mesh is at it: where a part is, a photo differs from it by more than these do among
/// themselves, and where one floats that is not there, it does not. Needs no texture: a ring of plain clay is
/// borne out, and a scrap of surface before a patterned wall is refuted.
///
/// Each photo that shows enough of a part by itself has one vote, because a photo's pixels err together. The
/// part is there or not by what is likelier, chance or as often as with the largest part
/// (background_votes.h).
class PartsBeforeBackground {
 public:
  /// \param photos      must stay. \param station_of_photo  photos of one number are of a camera that stands
  /// still; below 0: of one by itself. \param reporter  must stay.
  PartsBeforeBackground(const RefinementPhotoSource& photos, std::vector<int> station_of_photo,
                        int num_threads, Reporter& reporter);

  /// As a PartJudge. The largest part is kUnknown; none is kNotThere where photos do not tell the largest
  /// from chance. Photos are loaded only where there is a part to judge. Bit-identical for any number of
  /// threads. Throws what the source throws, and Interrupted.
  std::vector<PartSight> Judge(const TriangleMesh& mesh, const std::vector<int>& part_of_triangle) const;

 private:
  const RefinementPhotoSource& photos_;
  const std::vector<int> station_of_photo_;
  const int num_threads_;
  Reporter& reporter_;
};

}  // namespace s2gs
