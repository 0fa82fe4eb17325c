#include "sfm_split/split/motion_split.h"

#include <algorithm>
#include <array>
#include <iomanip>
#include <set>
#include <sstream>
#include <utility>

#include "sfm_split/base/number_text.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/matching/image_similarity.h"
#include "sfm_split/split/hand_held_split.h"
#include "sfm_split/split/pair_rings.h"
#include "sfm_split/split/split_matching.h"
#include "sfm_split/split/station_split.h"

namespace s2gs {
namespace {

constexpr size_t kCoarseFeatures = 300;    // that all images are compared by
constexpr double kMinStationImages = 0.5;  // share of the photos that must stand at a station with others
constexpr double kNoiseLimit = 4;          // matches that moved by more bounds did move
constexpr double kMinTurningPairs = 0.5;   // pairs of the rotating part per photo
constexpr size_t kLeastOfPose = 30;        // matches; colmap mapper asks a photo's pose for as many
constexpr size_t kLeastOfTurn = 3;         // photos of a station that can be a ring
constexpr int kOneInLacks = 10;            // photos without a ring, of those at stations

// How far keypoints that did not move lie apart: the median over pairs of one station.
double UnmovedDistance(const SplitMatching& matching, const Stations& stations,
                       const std::vector<ImagePairMatches>& pairs) {
  const double limit = kNoiseLimit * matching.settings().station.max_unmoved_px;
  std::vector<double> distances;
  for (const ImagePairMatches& pair : pairs) {
    if (stations.station_of_image[pair.image1] != stations.station_of_image[pair.image2]) continue;
    for (const FeatureMatch& match : pair.matches) {
      const Eigen::Vector2f expected =
          stations.Move(pair.image1, pair.image2, matching.keypoints()[pair.image1][match.point2D_idx1]);
      const double distance = (matching.keypoints()[pair.image2][match.point2D_idx2] - expected).norm();
      if (distance <= limit) distances.push_back(distance);
    }
  }
  return UpperMedian(std::move(distances));
}

// Stations from the largest features of all pairs, which does not ask for photos in the order of capture, and
// from all features of neighbours for those photos that this leaves alone.
Stations FindStationsOfPhotos(const ScanPictures* pictures, SplitMatching* matching,
                              SimilarityMatrix* similarity) {
  const auto num = static_cast<uint32_t>(matching->NumImages());
  const PackedImages largest = matching->PackLargest(kCoarseFeatures, [](int, uint32_t) { return true; });
  std::vector<ImagePairMatches> candidates;
  *similarity = SimilarityMatrix::Zero(num, num);
  constexpr size_t kBlock = 1024;  // pairs between two looks at whether to stop
  std::vector<ImagePair> pairs;
  std::vector<DescriptorMatcher::Job> jobs;
  std::vector<FeatureMatches> matches;
  const StationOptions& options = matching->settings().station;
  const auto flush = [&](int64_t done) {
    if (matching->reporter().StopRequested()) throw Interrupted();
    matching->matcher()->MatchAll(jobs, &matches);
    for (size_t p = 0; p < pairs.size(); ++p) {
      const auto [i, j] = pairs[p];
      (*similarity)(i, j) = (*similarity)(j, i) = static_cast<uint32_t>(matches[p].size());
      ImagePairMatches pair{static_cast<int>(i), static_cast<int>(j), std::move(matches[p])};
      const UnmovedMatches unmoved = FindUnmovedMatches(matching->keypoints()[i], matching->keypoints()[j],
                                                        pair, matching->sizes()[i], options);
      if (unmoved.same_station) candidates.push_back(std::move(pair));
    }
    pairs.clear();
    jobs.clear();
    matching->reporter().Progress("compare photos", done, int64_t{num} * (num - 1) / 2);
  };
  int64_t done = 0;
  for (uint32_t i = 0; i < num; ++i) {
    for (uint32_t j = i + 1; j < num; ++j) {
      pairs.push_back({i, j});
      jobs.push_back({&largest[i], &largest[j]});
      ++done;
      if (pairs.size() == kBlock) flush(done);
    }
  }
  if (!pairs.empty()) flush(done);
  const auto group = [&] {
    const std::vector<StationJoin> joins =
        FindStationJoins(matching->keypoints(), matching->sizes(), candidates, options);
    if (pictures == nullptr) return GroupJoined(num, joins, options);
    return JoinStations(pictures->pictures, pictures->stations, joins, options);
  };
  Stations stations = group();

  std::set<ImagePair> neighbours;
  for (uint32_t i = 0; i < num; ++i) {
    if (stations.images[stations.station_of_image[i]].size() > 1) continue;
    if (i > 0) neighbours.insert({i - 1, i});
    if (i + 1 < num) neighbours.insert({i, i + 1});
  }
  if (neighbours.empty()) {
    matching->AdaptToNoise(UnmovedDistance(*matching, stations, candidates));
    return stations;
  }
  for (ImagePairMatches& pair :
       matching->Match({neighbours.begin(), neighbours.end()}, matching->PackAll(), "match neighbours")) {
    candidates.push_back(std::move(pair));
  }
  stations = group();
  matching->AdaptToNoise(UnmovedDistance(*matching, stations, candidates));
  return stations;
}

double ShareAtStations(const Stations& stations) {
  size_t num = 0;
  for (const std::vector<int>& station : stations.images) num += station.size() >= 2 ? station.size() : 0;
  return static_cast<double>(num) / static_cast<double>(stations.station_of_image.size());
}

void CountRinged(MotionSplit* split) {
  const auto& stations = split->stations.images;
  std::vector<std::vector<std::pair<int, int>>> pairs(stations.size());
  std::vector<int> place(split->stations.station_of_image.size(), 0);
  for (const std::vector<int>& station : stations) {
    for (size_t p = 0; p < station.size(); ++p) place[station[p]] = static_cast<int>(p);
  }
  for (const VerifiedPair& pair : split->object_pairs) {
    const int station = split->stations.station_of_image[pair.image1];
    if (station != split->stations.station_of_image[pair.image2] || pair.matches.size() < kLeastOfPose)
      continue;
    pairs[station].emplace_back(place[pair.image1], place[pair.image2]);
  }
  for (size_t s = 0; s < stations.size(); ++s) {
    if (stations[s].size() < kLeastOfTurn) continue;
    split->station_photos += static_cast<int>(stations[s].size());
    const int ring = LargestRing(static_cast<int>(stations[s].size()), pairs[s]);
    split->ringed_photos += ring > 1 ? ring : 0;
  }
}

std::string Percent(double share) {
  std::ostringstream text;
  text << std::setprecision(2) << 100 * share << " %";
  return text.str();
}

bool HasGivenLabels(const std::vector<SplitImage>& images) {
  return std::any_of(images.begin(), images.end(),
                     [](const SplitImage& image) { return !image.given_labels.empty(); });
}

void Split(const ScanPictures* pictures, SplitMatching* matching, MotionSplit* split) {
  SimilarityMatrix similarity;
  split->stations = FindStationsOfPhotos(pictures, matching, &similarity);
  const size_t num_stations = split->stations.images.size();
  const double at_stations = ShareAtStations(split->stations);
  const bool has_masks = HasGivenLabels(matching->images());
  if (at_stations < kMinStationImages && !has_masks) {
    SplitWithoutStations(similarity, /*expect_one_body=*/false, matching, split);
    return;
  }
  SplitByStations(pictures, matching, split);
  CountRinged(split);
  const double active_share = pictures == nullptr ? 0 : pictures->changes.MedianActiveShare();
  const bool has_turned =
      static_cast<double>(split->object_pairs.size()) >= kMinTurningPairs * matching->NumImages();
  const int without_ring = split->station_photos - split->ringed_photos;
  split->has_changes = active_share > 0;
  split->lacks_features =
      split->has_changes && (!has_turned || kOneInLacks * without_ring > split->station_photos);
  if (!has_turned && active_share > 0) {
    split->warnings.push_back("only " + std::to_string(split->object_pairs.size()) +
                              " pairs of photos have features that turn, though " + Percent(active_share) +
                              " of the picture change from photo to photo");
  } else if (!has_turned) {
    const size_t num_pairs = split->object_pairs.size();
    const Stations stations = split->stations;
    *split = MotionSplit();
    split->stations = stations;
    split->reason = "nothing turns: at " + std::to_string(num_stations) + " stations only " +
                    std::to_string(num_pairs) + " pairs of photos show anything but the background move";
    SplitWithoutStations(similarity, /*expect_one_body=*/true, matching, split);
    return;
  }
  split->capture_case = num_stations == 1 ? CaptureCase::kSingleStation : CaptureCase::kTurntable;
  split->reason = std::to_string(num_stations) + (num_stations == 1 ? " station" : " stations") +
                  ", at which the background stays in place while " +
                  std::to_string(split->object_pairs.size()) + " pairs of photos show the rest turning";
  if (has_masks) split->reason += "; labels come from the masks";
  if (split->capture_case == CaptureCase::kTurntable && split->static_pairs.empty()) {
    split->warnings.emplace_back(
        "the background is not recognised from one station to another: how their cameras stand to each "
        "other rests on the object");
  }
}

}  // namespace

OptionCheck MotionSplitOptions::Check() const {
  const std::array<std::pair<const char*, int>, 6> positive = {
      {{"min_static_support", min_static_support},
       {"max_object_steps", max_object_steps},
       {"station_partners", station_partners},
       {"max_nearby_stations", max_nearby_stations},
       {"min_rotating_matches", min_rotating_matches},
       {"max_exhaustive_pairs", max_exhaustive_pairs}}};
  for (const auto& [name, value] : positive) {
    if (value < 1) return OptionFault{name, std::to_string(value), ">= 1"};
  }
  if (!(min_moved_px > 0)) return OptionFault{"min_moved_px", NumberText(min_moved_px), "> 0"};
  return std::nullopt;
}

MotionSplit SplitMotion(const std::vector<SplitImage>& images, const SplitSettings& settings,
                        Reporter* reporter, const GivenMatches& given, const ScanPictures* pictures) {
  SplitMatching matching(images, settings, reporter, given);
  MotionSplit split;
  Split(pictures, &matching, &split);
  split.num_pairs_matched = matching.num_pairs_matched();
  return split;
}

}  // namespace s2gs
