#include "sfm_split/placement/one_camera.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
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

// Photos of which this share shows things that stay at their pixels, each in so many matches more than the
// unverified ones would by chance, and a Poisson number's five sigmas more than these.
constexpr double kLeastShareStill = 0.5;
constexpr double kLeastStill = 5;

// Cameras that stand on a circle about a thing that rests, as a rig's do, see all of it move; a camera that
// rests sees the room stay, even where hardly any of it shows. What wrong matches say by chance does not
// count, nor do those of the one body.
bool ShowWhatStandsStill(const ScanFeatures& features) {
  std::map<std::pair<int, int>, std::set<std::pair<uint32_t, uint32_t>>> of_body;
  for (const ImagePairMatches& pair : features.object_pairs) {
    auto& matches = of_body[{pair.image1, pair.image2}];
    for (const FeatureMatch& match : pair.matches) matches.emplace(match.point2D_idx1, match.point2D_idx2);
  }
  std::vector<double> still(features.images.size(), 0);
  std::vector<double> by_chance(features.images.size(), 0);
  for (const ImagePairMatches& pair : features.raw_pairs) {
    const ScanImage& first = features.images[static_cast<size_t>(pair.image1)];
    const ScanImage& second = features.images[static_cast<size_t>(pair.image2)];
    const Camera& camera = features.cameras.at(second.camera_id);
    const double chance =
        kPi * kLeastMovePx * kLeastMovePx / (static_cast<double>(camera.width) * camera.height);
    const auto& verified = of_body[{pair.image1, pair.image2}];
    double num_still = 0;
    double num_others = 0;
    for (const FeatureMatch& match : pair.matches) {
      if (verified.count({match.point2D_idx1, match.point2D_idx2}) > 0) continue;
      ++num_others;
      const float moved = (first.keypoints[match.point2D_idx1] - second.keypoints[match.point2D_idx2]).norm();
      if (moved < kLeastMovePx) ++num_still;
    }
    for (const int image : {pair.image1, pair.image2}) {
      still[static_cast<size_t>(image)] += num_still;
      by_chance[static_cast<size_t>(image)] += chance * num_others;
    }
  }
  size_t num_showing = 0;
  for (size_t i = 0; i < still.size(); ++i) {
    if (still[i] >= kLeastStill + by_chance[i] + 5 * std::sqrt(by_chance[i])) ++num_showing;
  }
  return static_cast<double>(num_showing) >= kLeastShareStill * static_cast<double>(still.size());
}

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
  if (objects.empty() || !ShowWhatStandsStill(features) || !StandOnOneCircle(objects[0], options.turntable)) {
    return std::nullopt;
  }
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
