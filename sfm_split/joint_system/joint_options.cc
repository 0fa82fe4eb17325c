#include "sfm_split/joint_system/joint_options.h"

#include "sfm_split/base/number_text.h"

namespace s2gs {

const char* JointModelName(JointModel model) {
  switch (model) {
    case JointModel::kAuto:
      return "auto";
    case JointModel::kSharedStations:
      return "shared stations";
    case JointModel::kFreeCameras:
      return "free cameras";
    case JointModel::kWobblingTable:
      return "wobbling table";
    case JointModel::kFreeObject:
      return "free object";
  }
  return "";
}

OptionCheck JointOptions::Check() const {
  const auto fault = [](const char* field, double value, const char* bound) {
    return OptionFault{field, NumberText(value), bound};
  };
  if (!(loss_scale_px >= 0)) return fault("loss_scale_px", loss_scale_px, "loss_scale_px >= 0");
  if (!(max_reprojection_error_px > 0)) {
    return fault("max_reprojection_error_px", max_reprojection_error_px, "max_reprojection_error_px > 0");
  }
  if (!(min_triangulation_deg >= 0)) {
    return fault("min_triangulation_deg", min_triangulation_deg, "min_triangulation_deg >= 0");
  }
  if (max_rounds < 1) return fault("max_rounds", max_rounds, "max_rounds >= 1");
  if (max_iterations < 1) return fault("max_iterations", max_iterations, "max_iterations >= 1");
  if (!(function_tolerance >= 0))
    return fault("function_tolerance", function_tolerance, "function_tolerance >= 0");
  if (min_free_observations < 3) {
    return fault("min_free_observations", min_free_observations, "min_free_observations >= 3");
  }
  if (num_threads < 0) return fault("num_threads", num_threads, "num_threads >= 0");
  return std::nullopt;
}

}  // namespace s2gs
