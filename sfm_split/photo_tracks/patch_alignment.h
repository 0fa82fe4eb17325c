#pragma once

#include <Eigen/Core>
#include <vector>

#include "sfm_split/base/error.h"
#include "sfm_split/base/rigid3.h"
#include "sfm_split/photo_tracks/spline_part.h"
#include "sfm_split/scene/camera_model.h"

namespace s2gs {

/// A photo around the place where it shows a point.
struct PatchView {
  const SplinePart* photo = nullptr;
  const Camera* camera = nullptr;
  Rigid3 cam_from_body;
};

struct PatchOptions {
  /// Of a patch, in the photo that stands for the others: a wider one is no plane on most surfaces, and a
  /// photo's place follows the part that it sees best.
  int radius_px = 5;
  double min_correlation = 0.8;  ///< of a photo's patch with the mean of the others.
  double max_move_px = 2;        ///< from where the poses say.
  int max_iterations = 20;

  OptionCheck Check() const;
};

/// Where a photo shows a patch.
struct PatchPlace {
  bool is_found = false;
  Eigen::Vector2d xy = Eigen::Vector2d::Zero();  ///< [px]
  double sigma_px = 0;  ///< standard deviation in the worse direction, by gradients and residuals.
  double correlation = 0;
};

/// A small plane of a body's surface.
struct SurfacePatch {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();
};

/// Where several photos show one patch of a surface, to what their noise allows: the patch is projected into
/// each by its pose, and shifted to where it agrees best with the mean of the others, but for contrast,
/// brightness and a ramp of it (least squares matching). The patch's normal is adjusted along. The places
/// mean one point of the surface, near `patch->centre`; places of one set of views are comparable among each
/// other alone. \param reference  the view that the others are first compared with.
std::vector<PatchPlace> AlignPatch(const std::vector<PatchView>& views, size_t reference,
                                   const PatchOptions& options, SurfacePatch* patch);

}  // namespace s2gs
