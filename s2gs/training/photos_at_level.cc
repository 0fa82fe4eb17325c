#include "s2gs/training/photos_at_level.h"

#include <algorithm>
#include <cstdint>

#include "s2gs/image/photos.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {

std::vector<TrainingPhoto> PhotosAtLevel(const TrainingScene& scene, int level, int min_size) {
  std::vector<const ScenePhoto*> trained;
  for (const ScenePhoto& photo : scene.photos) {
    if (!photo.held_out) trained.push_back(&photo);
  }
  std::vector<TrainingPhoto> photos(trained.size());
  ParallelFor(static_cast<int64_t>(trained.size()), 0, [&](int64_t i) {
    const ScenePhoto& photo = *trained[static_cast<size_t>(i)];
    int own_level = level;
    while (own_level > 0 && std::max(photo.view.width, photo.view.height) >> own_level < min_size)
      --own_level;
    const int width = std::max(1, photo.view.width >> own_level);
    const int height = std::max(1, photo.view.height >> own_level);
    TrainingPhoto& reduced = photos[static_cast<size_t>(i)];
    reduced.view = ResizeView(photo.view, width, height);
    reduced.image = ResizeByArea(photo.image, width, height);
    if (photo.mask.empty()) return;
    const Image8 mask{photo.view.width, photo.view.height, 1, photo.mask};
    reduced.mask = ResizeByArea(mask, width, height).pixels;
    for (uint8_t& value : reduced.mask) value = value > 127 ? 255 : 0;
  });
  return photos;
}

}  // namespace s2gs
