#pragma once

#include <algorithm>

#include "s2gs/scene/scene_lengths.h"
#include "s2gs/scene/training_scene.h"
#include "tests/support/synthetic_render.h"
#include "tests/support/synthetic_turntable.h"

namespace s2gs {

/// A small turntable scene in memory: rendered photos with exact poses, the turntable's points as sparse
/// points, every fifth photo held out with its true mask.
inline TrainingScene MakeSmallScene(TrainMode mode, int width, int height, int stations, int steps) {
  SyntheticTurntableOptions options;
  options.stations = stations;
  options.steps = steps;
  options.step_deg = std::min(120.0, 360.0 / steps);
  options.turning = mode != TrainMode::kStatic;
  options.width = width;
  options.height = height;
  options.num_object_points = 250;
  options.num_platter_points = 150;
  options.num_background_points = 400;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  SyntheticRenderOptions render_options;
  render_options.use_turntable_object = true;
  render_options.supersampling = 2;
  const SyntheticRenderScene render_scene = MakeSyntheticRenderScene(turntable, render_options);

  TrainingScene scene;
  scene.mode = mode;
  for (size_t i = 0; i < turntable.scene.views.size(); ++i) {
    const View& view = turntable.scene.views[i];
    const Camera& camera = turntable.CameraOf(static_cast<int>(i));
    const SyntheticRendering rendering = RenderImage(render_scene, turntable, static_cast<int>(i));
    ScenePhoto photo;
    photo.name = view.name;
    photo.view.width = width;
    photo.view.height = height;
    photo.view.fx = FocalLengths(camera).x();
    photo.view.fy = FocalLengths(camera).y();
    photo.view.cx = PrincipalPoint(camera).x();
    photo.view.cy = PrincipalPoint(camera).y();
    photo.view.cam_from_object = view.CamFromObject();
    photo.view.cam_from_world = mode == TrainMode::kS2gs ? view.cam_from_world : view.CamFromObject();
    photo.image = rendering.rgb;
    for (const uint8_t label : rendering.label.pixels)
      photo.truth_mask.push_back(label != kStaticLabel ? 255 : 0);
    if (mode == TrainMode::kMasks) photo.mask = photo.truth_mask;
    photo.held_out = i % 5 == 2;
    photo.station = view.station;
    scene.photos.push_back(std::move(photo));
  }
  for (const SyntheticPoint& point : turntable.points) {
    if (point.body == SyntheticBody::kNone || point.body == SyntheticBody::kWatermark) continue;
    const bool rotates = IsRotating(point.body);
    if (mode == TrainMode::kMasks && !rotates) continue;
    scene.points.push_back({point.x, point.color, rotates && mode != TrainMode::kStatic});
  }
  scene.axis = turntable.scene.axis;
  NormaliseScene(&scene);
  return scene;
}

}  // namespace s2gs
