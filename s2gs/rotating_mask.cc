#include "s2gs/rotating_mask.h"

#include <algorithm>

namespace s2gs {
namespace {

bool IsOneStation(const TrainingScene& scene) {
  return std::all_of(scene.photos.begin(), scene.photos.end(),
                     [&](const ScenePhoto& photo) { return photo.station == scene.photos[0].station; });
}

}  // namespace

RenderRequest MaskRequest(const TrainingScene& scene, const PinholeView& view) {
  RenderRequest request;
  request.view = view;
  // A scene where nothing turns has Gaussians of the object too, by where they are.
  request.bodies = scene.mode == TrainMode::kMasks ? SceneBodies::kObjectOnly : SceneBodies::kBoth;
  request.foreground = true;
  request.hard_foreground = true;
  if (scene.mode != TrainMode::kS2gs) return request;
  if (IsOneStation(scene)) {
    request.drawn = DrawnBody::kForeground;
  } else {
    request.without_static = scene.region;
  }
  return request;
}

PixelMask RotatingMask(const RenderedView& view) {
  PixelMask mask{view.width, view.height, {}};
  mask.inside.reserve(view.foreground.size());
  for (const float value : view.foreground) mask.inside.push_back(value > 0.5F ? 1 : 0);
  return mask;
}

}  // namespace s2gs
