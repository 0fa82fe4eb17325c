#include "sfm_split/rim/scene_rims.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <optional>
#include <string>
#include <utility>

#include "sfm_split/base/error.h"
#include "sfm_split/base/median_of_pictures.h"
#include "sfm_split/base/number_text.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/pictures/still_picture.h"
#include "sfm_split/rim/rim_search.h"
#include "sfm_split/silhouettes/silhouette.h"

namespace s2gs {
namespace {

constexpr double kFew = 0.05;  // of points, which may be strays

RimSearch SearchAbout(const AlignedScene& aligned) {
  RimSearch search;
  search.axis = aligned.scene.axis;
  std::vector<double> heights;
  std::vector<double> radii;
  for (const auto& [id, point] : aligned.object.points3D) {
    const Eigen::Vector3d from_axis = point.xyz - search.axis.point;
    heights.push_back(from_axis.dot(search.axis.direction));
    radii.push_back((from_axis - heights.back() * search.axis.direction).norm());
  }
  if (heights.empty()) return search;
  search.low = Quantile(heights, kFew);
  search.high = Quantile(std::move(heights), 1 - kFew);
  search.radius = Quantile(std::move(radii), 1 - kFew);
  return search;
}

// How the station's first photo, as the split has it, shows what most of the station's photos do.
std::optional<GreyPicture> StillPicture(const ReadGreyPhoto& read, const ScanFeatures& features, int station,
                                        Reporter& reporter) {
  std::vector<GreyPicture> pictures;
  for (const ScanImage& image : features.images) {
    if (image.station != station) continue;
    if (reporter.StopRequested()) throw Interrupted();
    const GreyPhoto photo = read(image.name);
    if (photo.grey.empty()) continue;
    GreyPicture picture = PictureOf(photo);
    if (!pictures.empty() && picture.photo_size != pictures.front().photo_size) continue;
    const Eigen::Vector2d scale = picture.Scale();
    const Eigen::Matrix3d to_photo = Eigen::Vector3d(scale.x(), scale.y(), 1).asDiagonal();
    const Eigen::Matrix3d H = to_photo.inverse() * image.photo_from_first * to_photo;
    pictures.push_back(SeenFrom(H, picture));
  }
  if (pictures.size() < kPicturesForMedian) return std::nullopt;
  std::vector<const GreyPicture*> all;
  all.reserve(pictures.size());
  for (const GreyPicture& picture : pictures) all.push_back(&picture);
  return MedianPicture(all);
}

}  // namespace

std::vector<RimPrior> FindRims(const ReadGreyPhoto& read, const ScanFeatures& features,
                               const AlignedScene& aligned, Reporter& reporter) {
  std::map<std::string, const View*> view_of_name;
  for (const View& view : aligned.scene.views) view_of_name[view.name] = &view;
  std::map<int, int> first_of_station;  // image that has a place
  for (size_t i = 0; i < features.images.size(); ++i) {
    if (view_of_name.count(features.images[i].name) > 0)
      first_of_station.try_emplace(features.images[i].station, static_cast<int>(i));
  }
  const RimSearch search = SearchAbout(aligned);
  std::vector<RimPrior> rims;
  for (const auto& [station, image] : first_of_station) {
    const View& view = *view_of_name.at(features.images[static_cast<size_t>(image)].name);
    const Camera* const camera = aligned.scene.FindCamera(view.camera_id);
    const std::optional<GreyPicture> still = StillPicture(read, features, station, reporter);
    if (camera == nullptr || !still) continue;
    const std::optional<FoundRim> found = FindRim({*still, *camera, view.cam_from_world}, search);
    reporter.Debug("the table's rim at station " + std::to_string(station) + ": " +
                   (found ? NumberText(100 * found->share) + " % of its places, to " +
                                NumberText(found->sigma_px) + " px, " + NumberText(found->false_alarms) +
                                " expected by chance"
                          : std::string("not found")));
    if (!found) continue;
    RimPrior rim;
    rim.image = image;
    rim.places = found->places;
    rim.sigma_px = found->sigma_px;
    rim.log_odds = -std::log(std::max(found->false_alarms, std::numeric_limits<double>::min()));
    rims.push_back(std::move(rim));
  }
  std::stable_sort(rims.begin(), rims.end(),
                   [](const RimPrior& a, const RimPrior& b) { return a.log_odds > b.log_odds; });
  return rims;
}

}  // namespace s2gs
