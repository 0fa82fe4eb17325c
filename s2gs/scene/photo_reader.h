#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <vector>

#include "s2gs/image/image_file.h"
#include "s2gs/image/photos.h"
#include "s2gs/scene/training_scene.h"
#include "sfm_split/base/reporter.h"
#include "sfm_split/scene/camera_model.h"

namespace s2gs {

/// Reads photos and masks as training takes them: without distortion, at their size in training.
class PhotoReader {
 public:
  /// All of them outlive the reader.
  PhotoReader(const TrainingScenePaths& paths, const TrainingSceneOptions& options, Reporter& reporter)
      : paths_(paths), options_(options), reporter_(reporter) {}

  /// Sets the view's intrinsics and size, by the camera and whether the photo is held out; poses stay. Throws
  /// UserError for cameras that cannot be undistorted.
  void PlanView(const Camera& camera, ScenePhoto* photo);

  /// Reads a photo whose view is planned and its masks; from several threads, too. Throws UserError, with the
  /// file's path, and Interrupted. \param needs_mask  a mask that is not there is a fault.
  void Read(const Camera& camera, bool with_mask, bool needs_mask, ScenePhoto* photo);

 private:
  const Undistortion& Plan(const Camera& camera);
  Image8 Undistort(const Image8& image, const Camera& camera);
  std::vector<uint8_t> ReadMaskOf(const std::filesystem::path& folder, const Camera& camera, bool is_needed,
                                  const ScenePhoto& photo);

  const TrainingScenePaths& paths_;
  const TrainingSceneOptions& options_;
  Reporter& reporter_;
  std::map<uint32_t, Undistortion> undistortions_;  // by camera
};

}  // namespace s2gs
