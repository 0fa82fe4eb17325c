#include "sfm_split/relocalise/one_camera.h"

#include <algorithm>
#include <utility>

#include "sfm_split/base/angles.h"
#include "sfm_split/turntable/turntable.h"

namespace s2gs {
namespace {

constexpr double kMost = 0.9;  // single photos' poses may be wrong
// A table's plate wobbles by up to a degree; what a hand aims at strays by several. Of a place, the same over
// its distance.
constexpr double kWobbleDeg = 1;
constexpr size_t kLeastOfCircle = 6;  // poses: an axis and a place before it take three of them

// By SfM's poses, each with the error that SfM leaves.
bool StandOnOneCircle(const ColmapModel& object, const TurntableOptions& options) {
  std::vector<TurntablePose> poses;
  for (const auto& [id, image] : object.images)
    poses.push_back({image.name, 0, image.cam_from_world, Rigid3()});
  std::sort(poses.begin(), poses.end(),
            [](const TurntablePose& a, const TurntablePose& b) { return a.name < b.name; });
  const TurntableSolution solution = SolveTurntable(poses, options);
  return solution.motion == TurntableMotion::kRotates && poses.size() >= kLeastOfCircle &&
         solution.groups[0].num_images >= kMost * static_cast<double>(poses.size()) &&
         solution.rotation_sigma_deg <= kWobbleDeg && solution.offset_sigma_rel <= kWobbleDeg * kPi / 180;
}

}  // namespace

std::optional<OneCameraScan> PlaceBeforeOneCamera(const ScanFeatures& features,
                                                  const std::vector<ColmapModel>& objects,
                                                  const ReadDescriptors& read_descriptors,
                                                  const ReadGreyPhoto& read_photo,
                                                  const PlacementOptions& options, Reporter& reporter) {
  if (objects.empty() || !StandOnOneCircle(objects[0], options.turntable)) return std::nullopt;
  reporter.Info("the cameras stand on a circle about one axis, as one before a table does");
  OneCameraScan scan;
  scan.features = features;
  for (ScanImage& image : scan.features.images) {
    image.station = 0;
    image.photo_from_first.setIdentity();
  }
  scan.features.static_pairs.clear();
  scan.features.raw_static_pairs.clear();
  scan.placement =
      PlaceScan(scan.features, objects, nullptr, read_descriptors, read_photo, options, reporter);
  if (scan.placement.outcome != PlacementOutcome::kPlaced) return std::nullopt;
  if (scan.placement.best.aligned.scene.views.size() < objects[0].images.size()) {
    reporter.Info("which does not place all of their photos: they are taken as those of one body");
    return std::nullopt;
  }
  scan.finding = "1 station: the cameras of " + std::to_string(objects[0].images.size()) +
                 " photos of one body stand on a circle about one axis, as one before a table does";
  return scan;
}

}  // namespace s2gs
