#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "mesh/surface/triangle_mesh.h"
#include "plugin/report/figures.h"
#include "plugin/stage/workspace.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/reporter.h"
#include "sfm_split/base/rigid3.h"
#include "sfm_split/scene/scene_truth.h"

namespace s2gs {

/// Everything that ground truth says, read once.
struct ScanTruth {
  SceneTruth scene;
  TriangleMesh object;               ///< in the object's frame.
  std::optional<TriangleMesh> disc;  ///< what the object stands on; not every data set has one.
  double diameter = 0;  ///< diagonal of the object's bounding box, in the truth's unit of length.
};

/// Reads SCENE/gt. Throws UserError when a file is missing or damaged, or the object has no extent.
ScanTruth ReadScanTruth(const std::filesystem::path& scene_folder);

/// What EvaluatePoses found out for the figures that need alignment.
struct ScanAlignment {
  std::optional<Sim3> truth_from_object;  ///< from sparse/0's frame to the true object frame.
  std::string reason;                     ///< why there is none.
};

/// Poses of both models, turntable angles, axis and scale. What the workspace lacks becomes a missing figure.
ScanAlignment EvaluatePoses(const Workspace& workspace, const ScanTruth& truth, Figures* figures);

/// The workspace's masks against the labels of the train images.
void EvaluateMasks(const Workspace& workspace, const SceneTruth& truth, Reporter& reporter, Figures* figures);

struct MeshEvaluationOptions {
  int64_t num_samples = 200'000;
  int64_t num_truth_samples = 1'000'000;
  std::vector<double> thresholds_pct = {0.5, 1, 2};
  std::vector<double> crop_min;
  std::vector<double> crop_max;

  OptionCheck Check() const;
};

/// A mesh in sparse/0's frame against the true surface.
void EvaluateMesh(const std::filesystem::path& mesh_path, const ScanAlignment& alignment,
                  const ScanTruth& truth, const MeshEvaluationOptions& options, uint64_t seed,
                  Figures* figures);

/// Where rendered images, photos and masks to compare lie.
struct ImagePaths {
  std::filesystem::path rendered;
  std::filesystem::path reference;  ///< empty: the data set's photos.
  std::filesystem::path masks;      ///< empty: the data set's labels, or none.
};

/// PSNR and SSIM of rendered images, found by file name without extension. `truth` may be null.
void EvaluateImages(const ImagePaths& paths, const SceneTruth* truth, Reporter& reporter, Figures* figures);

}  // namespace s2gs
