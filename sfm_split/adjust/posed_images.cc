#include "sfm_split/adjust/posed_images.h"

#include <map>
#include <string>

namespace s2gs {

std::vector<PosedImage> PosedImages(const ScanFeatures& features, const TurntableScene& scene,
                                    bool of_object) {
  std::map<std::string, const View*> view_of;
  for (const View& view : scene.views) view_of[view.name] = &view;
  std::map<uint32_t, const Camera*> camera_of;
  for (const Camera& camera : scene.cameras) camera_of[camera.camera_id] = &camera;
  std::vector<PosedImage> posed(features.images.size());
  for (size_t i = 0; i < posed.size(); ++i) {
    const auto view = view_of.find(features.images[i].name);
    if (view == view_of.end()) continue;
    const auto camera = camera_of.find(view->second->camera_id);
    if (camera == camera_of.end()) continue;
    posed[i] = {true, camera->second,
                of_object ? view->second->CamFromObject() : view->second->cam_from_world};
  }
  return posed;
}

}  // namespace s2gs
