#include "sfm_split/silhouettes/scene_silhouettes.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

constexpr int kMaxRim = 60;  // places on an outline: neighbours say the same

// A station's photos (ViewsByAngle).
struct Station {
  std::vector<const View*> views;
  std::vector<Silhouette> silhouettes;
};

Station ReadStation(const ReadGreyPhoto& read, const TurntableScene& scene, int number, Reporter& reporter) {
  Station station;
  std::vector<GreyPicture> pictures;
  for (const View* view : ViewsByAngle(scene, number)) {
    if (reporter.StopRequested()) throw Interrupted();
    const GreyPhoto photo = read(view->name);
    if (photo.grey.empty()) continue;
    GreyPicture picture = PictureOf(photo);
    if (!pictures.empty() && picture.photo_size != pictures.front().photo_size) continue;
    station.views.push_back(view);
    pictures.push_back(std::move(picture));
  }
  if (!pictures.empty()) station.silhouettes = FindSilhouettes(pictures, kMaxRim);
  return station;
}

std::vector<SilhouetteView> ViewsOf(const Station& station, const TurntableScene& scene) {
  std::vector<SilhouetteView> views;
  for (size_t k = 0; k < station.views.size(); ++k) {
    const View& view = *station.views[k];
    const Camera* const camera = scene.FindCamera(view.camera_id);
    if (camera != nullptr) views.push_back({&station.silhouettes[k], camera, view.CamFromObject()});
  }
  return views;
}

}  // namespace

std::vector<const View*> ViewsByAngle(const TurntableScene& scene, int station) {
  std::vector<const View*> views;
  for (const View& view : scene.views) {
    if (view.station == station) views.push_back(&view);
  }
  std::sort(views.begin(), views.end(),
            [](const View* a, const View* b) { return a->angle_deg < b->angle_deg; });
  return views;
}

std::map<int, SilhouetteTurn> AskSilhouettes(const ReadGreyPhoto& read, const TurntableScene& scene,
                                             const std::vector<int>& stations, Reporter& reporter) {
  std::map<int, SilhouetteTurn> result;
  const View* const reference = scene.Reference();
  if (reference == nullptr) return result;
  const Station first = ReadStation(read, scene, reference->station, reporter);
  for (const int number : stations) {
    const Station second = ReadStation(read, scene, number, reporter);
    const SilhouetteTurn turn = FindSilhouetteTurn(ViewsOf(first, scene), ViewsOf(second, scene), scene.axis);
    reporter.Debug("silhouettes turn station " + std::to_string(number) + " by " +
                   std::to_string(turn.turn_rad / kDegree) + " +- " +
                   std::to_string(turn.sigma_rad / kDegree) + " degrees: contradictions " +
                   std::to_string(turn.error_px) + " px, elsewhere " + std::to_string(turn.elsewhere_px) +
                   " px (t " + std::to_string(turn.t) + ")");
    result[number] = turn;
  }
  return result;
}

}  // namespace s2gs
