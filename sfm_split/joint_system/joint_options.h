#pragma once

#include "sfm_split/base/error.h"

namespace s2gs {

/// What the poses share.
enum class JointModel {
  kAuto,            ///< the simplest of the below that the data do not reject.
  kSharedStations,  ///< one camera pose a station, one axis.
  kFreeCameras,     ///< a camera pose for each image with enough observations (hand-held, shaken), one axis.
  kWobblingTable,   ///< station poses, and poses of the object that go smoothly with the table's angle.
  kFreeObject,      ///< in addition, a pose of the object for each image (a table that wobbles).
};
const char* JointModelName(JointModel model);

enum class JointLoss { kSquared, kHuber, kCauchy };

/// Of the joint adjustment (AdjustJointly) and of its system.
struct JointOptions {
  JointModel model = JointModel::kAuto;
  bool refine_focal_length = true;
  bool refine_principal_point = false;
  bool refine_extra_params = true;
  JointLoss loss = JointLoss::kCauchy;
  /// Where the loss turns from squared; 0: at twice the standard deviation of a keypoint's coordinate, as the
  /// residuals show it.
  double loss_scale_px = 0;
  double max_reprojection_error_px = 4;  ///< observations beyond are taken out between rounds.
  double min_triangulation_deg = 0.25;   ///< points whose rays all meet at less are taken out.
  int max_rounds = 3;                    ///< of adjusting and taking out.
  int max_iterations = 100;              ///< of Levenberg-Marquardt, per round.
  double function_tolerance = 1e-8;      ///< relative decrease of the cost at which the last round stops.
  int min_free_observations = 12;        ///< of one body; images with fewer share their station's camera.
  bool compute_covariance = true;
  int max_dense_parameters = 1500;  ///< no covariance for more camera-side parameters than these.
  /// 0: all cores. Up to a thousand camera-side parameters the result is the same to the last bit for any
  /// number; with more it is so with one thread alone, which 0 then means.
  int num_threads = 0;

  OptionCheck Check() const;
};

}  // namespace s2gs
