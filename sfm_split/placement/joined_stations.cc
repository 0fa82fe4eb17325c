#include "sfm_split/placement/joined_stations.h"

#include <algorithm>
#include <iterator>
#include <map>
#include <set>
#include <utility>

#include "sfm_split/base/angles.h"
#include "sfm_split/evidence/scan_evidence.h"
#include "sfm_split/evidence/verdict.h"
#include "sfm_split/scene/axis_turn.h"

namespace s2gs {
namespace {

// A table's plate wobbles by up to a degree; what a hand aims at strays by several.
constexpr double kWobbleOfPlateDeg = 1;
constexpr int kLeastOfStation = 6;  // photos: an axis and a place before it take three of them

// A photo's camera, as the object sees it.
struct ObjectCamera {
  size_t image = 0;
  Rigid3 cam_from_object;
};

// But for the table's turn between them.
bool StandAlike(const TurntableAxis& axis, const Rigid3& a, const Rigid3& b) {
  const double turn_rad = AngleAboutAxis(axis, CameraCentre(a), CameraCentre(b));
  return AreCamerasClose(axis, a * TurnAbout(axis, -turn_rad), b, kWobbleOfPlateDeg * kDegree);
}

std::vector<int> StationOfEach(const ScanFeatures& features) {
  std::vector<int> stations;
  stations.reserve(features.images.size());
  for (const ScanImage& image : features.images) stations.push_back(image.station);
  return stations;
}

// Returns how many photos have changed theirs.
int JoinStations(const std::vector<int>& stations, ScanFeatures* features) {
  int num_moved = 0;
  for (size_t i = 0; i < stations.size(); ++i) {
    ScanImage& image = features->images[i];
    if (image.station == stations[i]) continue;
    image.station = stations[i];
    image.photo_from_first.setIdentity();
    ++num_moved;
  }
  // Of the background between stations.
  const auto is_inside = [&](const ImagePairMatches& pair) {
    return stations[static_cast<size_t>(pair.image1)] == stations[static_cast<size_t>(pair.image2)];
  };
  for (std::vector<ImagePairMatches>* pairs : {&features->static_pairs, &features->raw_static_pairs})
    pairs->erase(std::remove_if(pairs->begin(), pairs->end(), is_inside), pairs->end());
  return num_moved;
}

}  // namespace

std::optional<std::vector<int>> StationsByPoses(const ScanFeatures& features, const TurntableScene& scene) {
  std::map<std::string, size_t> image_of_name;
  for (size_t i = 0; i < features.images.size(); ++i) image_of_name[features.images[i].name] = i;
  const std::map<int, int> size_of_station = SizesOfStations(features);
  std::vector<int> stations = StationOfEach(features);
  const auto is_small = [&](size_t image) {
    return size_of_station.at(features.images[image].station) < kLeastOfStation;
  };
  std::vector<ObjectCamera> cameras;
  for (const View& view : scene.views) cameras.push_back({image_of_name.at(view.name), view.CamFromObject()});
  std::vector<std::vector<size_t>> near(cameras.size());  // of small stations, itself as well
  std::vector<std::set<int>> large_near(cameras.size());  // stations
  std::set<size_t> open;
  for (size_t s = 0; s < cameras.size(); ++s) {
    if (!is_small(cameras[s].image)) continue;
    open.insert(s);
    for (size_t t = 0; t < cameras.size(); ++t) {
      if (t != s && !StandAlike(scene.axis, cameras[s].cam_from_object, cameras[t].cam_from_object)) continue;
      if (is_small(cameras[t].image)) {
        near[s].push_back(t);
      } else {
        large_near[s].insert(features.images[cameras[t].image].station);
      }
    }
  }
  bool has_changed = false;
  while (!open.empty()) {
    std::vector<size_t> most;
    for (const size_t seed : open) {
      std::vector<size_t> left;
      std::copy_if(near[seed].begin(), near[seed].end(), std::back_inserter(left),
                   [&](size_t s) { return open.count(s) > 0; });
      if (left.size() > most.size()) most = std::move(left);
    }
    std::set<int> large;
    for (const size_t s : most) large.insert(large_near[s].begin(), large_near[s].end());
    const bool is_told =
        large.size() == 1 || (large.empty() && static_cast<int>(most.size()) >= kLeastOfStation);
    const int station = large.empty() ? features.images[cameras[most[0]].image].station : *large.begin();
    for (const size_t s : most) {
      if (is_told && std::exchange(stations[cameras[s].image], station) != station) has_changed = true;
      open.erase(s);
    }
  }
  if (!has_changed) return std::nullopt;
  return stations;
}

std::optional<std::vector<int>> StationsByOrder(const ScanFeatures& features) {
  const std::vector<ScanImage>& images = features.images;
  const std::map<int, int> size_of_station = SizesOfStations(features);
  const auto is_small = [&](size_t image) {
    return size_of_station.at(images[image].station) < kLeastOfStation;
  };
  std::vector<int> stations = StationOfEach(features);
  bool has_changed = false;
  for (size_t begin = 0, end = 0; begin < images.size(); begin = end) {
    end = begin + 1;
    if (!is_small(begin)) continue;
    while (end < images.size() && is_small(end)) ++end;
    std::set<int> beside;
    if (begin > 0) beside.insert(images[begin - 1].station);
    if (end < images.size()) beside.insert(images[end].station);
    const bool is_amid = begin > 0 && end < images.size() && beside.size() == 1;
    const bool is_a_place = !is_amid && static_cast<int>(end - begin) >= kLeastOfStation;
    // A few between two stations are of either, or of a place of their own.
    if (!is_a_place && beside.size() != 1) continue;
    const int station = is_a_place ? images[begin].station : *beside.begin();
    for (size_t i = begin; i < end; ++i) has_changed |= std::exchange(stations[i], station) != station;
  }
  if (!has_changed) return std::nullopt;
  return stations;
}

std::optional<JoinedScan> PlaceWithStationsJoined(const ScanFeatures& features, ScanPlacement* placed,
                                                  const std::vector<ColmapModel>& objects,
                                                  const ReadDescriptors& read_descriptors,
                                                  const ReadGreyPhoto& read_photo,
                                                  const PlacementOptions& options, Reporter& reporter) {
  const auto by_poses = StationsByPoses(features, placed->best.aligned.scene);
  const auto by_order = StationsByOrder(features);
  if (!by_poses && !by_order) return std::nullopt;
  const auto gather = [&](const ScanFeatures& of, const ScanCandidate& best) {
    return GatherEvidence(of, best.aligned, best.refined.joint, best.refined.priors.turns,
                          best.refined.held_back, best.matches, options.refine.max_error_px);
  };
  struct Worth {
    Verdict verdict;
    size_t num_placed;
  };
  if (!placed->evidence) placed->evidence = gather(features, placed->best);
  const Worth before = {JudgeScan(*placed->evidence).verdict, placed->best.aligned.scene.views.size()};
  // Nothing where it is worse than what was placed, or as good and `is_better` is asked.
  const auto place = [&](const std::vector<int>& stations, const char* told_by,
                         bool is_better) -> std::optional<JoinedScan> {
    JoinedScan joined;
    joined.features = features;
    joined.finding = std::to_string(JoinStations(stations, &joined.features)) +
                     " photos belong to others' camera places by " + told_by + ": " +
                     std::to_string(std::set<int>(stations.begin(), stations.end()).size()) + " stations";
    reporter.Info(joined.finding);
    joined.placement =
        PlaceScan(joined.features, objects, nullptr, read_descriptors, read_photo, options, reporter);
    if (joined.placement.outcome == PlacementOutcome::kPlaced) {
      joined.placement.evidence = gather(joined.features, joined.placement.best);
      const Worth now = {JudgeScan(*joined.placement.evidence).verdict,
                         joined.placement.best.aligned.scene.views.size()};
      const bool is_worse = now.num_placed < before.num_placed || now.verdict > before.verdict;
      const bool is_as_good = now.num_placed == before.num_placed && now.verdict == before.verdict;
      if (!is_worse && !(is_better && is_as_good)) return joined;
    }
    reporter.Info("which the adjustment does not bear out");
    return std::nullopt;
  };
  if (by_poses) {
    if (auto joined = place(*by_poses, "their poses", false)) return joined;
  }
  if (before.verdict == Verdict::kGood || !by_order || by_order == by_poses) return std::nullopt;
  return place(*by_order, "the order of the photos", true);
}

}  // namespace s2gs
