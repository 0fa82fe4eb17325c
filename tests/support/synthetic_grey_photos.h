#pragma once

#include <cstddef>
#include <map>
#include <string>
#include <utility>

#include "s2gs/image/image_file.h"
#include "sfm_split/photo_tracks/track_places.h"
#include "tests/support/synthetic_render.h"

namespace s2gs {

/// Grey photos of the turntable's own object, by their names.
inline std::map<std::string, GreyPhoto> RenderGreyPhotos(const SyntheticTurntable& turntable) {
  SyntheticRenderOptions render;
  render.use_turntable_object = true;
  const SyntheticRenderScene scene = MakeSyntheticRenderScene(turntable, render);
  std::map<std::string, GreyPhoto> photos;
  for (size_t i = 0; i < turntable.images.size(); ++i) {
    Image8 grey = GreyImage(RenderImage(scene, turntable, static_cast<int>(i)).rgb);
    photos[turntable.scene.views[i].name] = {grey.width, grey.height, std::move(grey.pixels)};
  }
  return photos;
}

}  // namespace s2gs
