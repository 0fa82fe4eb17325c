#include "s2gs/scene/photo_reader.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "s2gs/image/photo_folder.h"
#include "s2gs/image/undistort.h"
#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

void RequireSize(const fs::path& path, const Image8& image, const Camera& camera) {
  if (static_cast<uint64_t>(image.width) != camera.width ||
      static_cast<uint64_t>(image.height) != camera.height) {
    const bool turned = static_cast<uint64_t>(image.width) == camera.height &&
                        static_cast<uint64_t>(image.height) == camera.width;
    throw UserError(
        path,
        "is " + std::to_string(image.width) + " x " + std::to_string(image.height) + " pixels, its camera " +
            std::to_string(camera.width) + " x " + std::to_string(camera.height),
        turned ? "It seems to be turned by its EXIF orientation: give the photos as COLMAP saw them"
               : "Give the photos that the model was made from");
  }
}

void Binarise(Image8* mask) {
  for (uint8_t& value : mask->pixels) value = value > 127 ? 255 : 0;
}

}  // namespace

// From several threads once a view of the camera is planned.
const Undistortion& PhotoReader::Plan(const Camera& camera) {
  const auto found = undistortions_.find(camera.camera_id);
  if (found != undistortions_.end()) return found->second;
  if (LensTurnsBack(camera)) {
    reporter_.Warn(paths_.object_model.string() + ": the lens of camera " + std::to_string(camera.camera_id) +
                   " turns back within its photos: what they show near their borders is left out");
  }
  return undistortions_.emplace(camera.camera_id, PlanUndistortion(camera, paths_.object_model))
      .first->second;
}

Image8 PhotoReader::Undistort(const Image8& image, const Camera& camera) {
  const Undistortion& plan = Plan(camera);
  return UndistortImage(image, plan.source, plan.pinhole, reporter_);
}

void PhotoReader::PlanView(const Camera& camera, ScenePhoto* photo) {
  PinholeView view = ViewOfPinhole(Plan(camera).pinhole);
  const int longer = std::max(view.width, view.height);
  const int most =
      photo->held_out && options_.max_test_size > 0 ? options_.max_test_size : options_.max_image_size;
  if (longer > most) {
    const double scale = static_cast<double>(most) / longer;
    view = ResizeView(view, std::max(1, static_cast<int>(std::lround(view.width * scale))),
                      std::max(1, static_cast<int>(std::lround(view.height * scale))));
  }
  view.cam_from_world = photo->view.cam_from_world;
  view.cam_from_object = photo->view.cam_from_object;
  photo->view = view;
}

void PhotoReader::Read(const Camera& camera, bool with_mask, bool needs_mask, ScenePhoto* photo) {
  const fs::path path = paths_.images / photo->name;
  Image8 image = ReadImage(path, 3);
  RequireSize(path, image, camera);
  image = Undistort(image, camera);
  photo->image = ResizeByArea(image, photo->view.width, photo->view.height);
  if (with_mask) photo->mask = ReadMaskOf(paths_.masks, camera, needs_mask, *photo);
  if (photo->held_out && !paths_.truth_masks.empty()) {
    photo->truth_mask = ReadMaskOf(paths_.truth_masks, camera, false, *photo);
  }
}

// Empty when there is none and none is needed.
std::vector<uint8_t> PhotoReader::ReadMaskOf(const fs::path& folder, const Camera& camera, bool is_needed,
                                             const ScenePhoto& photo) {
  fs::path path = FindMask(folder, photo.name);
  if (path.empty() && !is_needed) return {};
  if (path.empty()) path = folder / (photo.name + ".png");  // whose absence is the fault
  Image8 mask = ReadMask(path);
  RequireSize(path, mask, camera);
  // Before pixels are mixed with their neighbours: 128 counts as much as 255.
  Binarise(&mask);
  mask = Undistort(mask, camera);
  Binarise(&mask);
  mask = ResizeByArea(mask, photo.view.width, photo.view.height);
  Binarise(&mask);
  return std::move(mask.pixels);
}

}  // namespace s2gs
