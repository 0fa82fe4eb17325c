#include "sfm_split/placement/rim_starts.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "sfm_split/rim/rim_alignment.h"
#include "sfm_split/scene/camera_model.h"

namespace s2gs {
namespace {

constexpr int kFocals = 4;        // on either side of what a scene has
constexpr double kPerOctave = 4;  // a sixth longer each: an adjustment finds what lies between

// The lens as it was before anything was adjusted, but for focal length and distortion.
Camera WithFocal(const Camera& before, const Camera& adjusted, double factor) {
  Camera camera = before;
  const CameraModelInfo& info = InfoOf(camera.model);
  for (size_t k = 0; k < info.NumParams(); ++k) {
    if (k < info.num_focal_params) camera.params[k] = factor * adjusted.params[k];
    if (k >= info.FirstExtraParam()) camera.params[k] = adjusted.params[k];
  }
  return camera;
}

}  // namespace

std::vector<RimStart> StartsByRims(const ScanFeatures& features,
                                   const std::vector<PossiblePair>& pairs_inside,
                                   const std::vector<RimPrior>& rims, const std::vector<AlignedScene>& scenes,
                                   size_t most, Reporter& reporter) {
  std::vector<RimStart> starts;
  for (const AlignedScene& scene : scenes) {
    bool is_known = true;
    for (const Camera& camera : scene.scene.cameras) {
      const FocalPrior prior =
          FocalPriorOf(features.cameras.at(camera.camera_id), HasPriorFocal(features, camera.camera_id));
      is_known &= prior.IsAsStated(std::log(FocalLengths(camera).mean()));
    }
    const int range = is_known ? 0 : kFocals;
    for (int k = -range; k <= range; ++k) {
      RimStart start;
      start.aligned = scene;
      start.aligned.object.points3D.clear();
      double log_prior = 0;
      for (Camera& camera : start.aligned.scene.cameras) {
        const Camera& before = features.cameras.at(camera.camera_id);
        camera = WithFocal(before, camera, std::exp2(k / kPerOctave));
        log_prior += LogPriorOfLens(camera, before, HasPriorFocal(features, camera.camera_id));
      }
      MoveToRims(rims, features, &start.aligned.scene);
      const MatchLikelihood matches = LikelihoodOfMatches(features, start.aligned, pairs_inside);
      start.sigma_px = matches.sigma_px;
      start.gain = matches.gain + log_prior;
      reporter.Debug("rims with a focal length of " +
                     std::to_string(FocalLengths(start.aligned.scene.cameras.front()).x()) + " px to " +
                     std::to_string(RimErrorPx(rims, features, start.aligned.scene)) +
                     " px: log-likelihood of the matches " + std::to_string(start.gain) + ", noise " +
                     std::to_string(start.sigma_px) + " px");
      starts.push_back(std::move(start));
    }
  }
  std::stable_sort(starts.begin(), starts.end(),
                   [](const RimStart& a, const RimStart& b) { return a.gain > b.gain; });
  if (starts.size() > most) starts.resize(most);
  return starts;
}

}  // namespace s2gs
