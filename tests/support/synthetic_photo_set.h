#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "sfm_split/scene/scene.h"
#include "tests/support/synthetic_render.h"
#include "tests/support/synthetic_turntable.h"

namespace s2gs {

struct SyntheticPhotoSetOptions {
  std::string extension = ".png";   ///< of the photos: .png or .jpg.
  int test_images_per_station = 1;  ///< held out, half a step after a training image.
  int mesh_segments = 96;           ///< around the round parts of the true meshes.
};

/// The held-out views that WriteSyntheticPhotoSet renders.
std::vector<View> SyntheticTestViews(const SyntheticTurntable& turntable,
                                     const SyntheticPhotoSetOptions& options);

/// Renders a whole small data set into `folder`, in the layout of the rendered data sets: images/,
/// images_test/, gt/scene.json, gt/object.ply, gt/disc.ply, gt/masks/. The photos take the place of the
/// turntable's keypoints: turn the points off (num_..._points = 0) where only photos are wanted. The views'
/// names get the extension.
void WriteSyntheticPhotoSet(const std::filesystem::path& folder, SyntheticTurntable turntable,
                            const SyntheticRenderScene& scene, const SyntheticPhotoSetOptions& options = {});

}  // namespace s2gs
