#include "sfm_split/split/station_split.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <utility>

#include "sfm_split/base/parallel_for.h"
#include "sfm_split/matching/image_similarity.h"
#include "sfm_split/split/folded_pairs.h"
#include "sfm_split/split/pair_evidence.h"
#include "sfm_split/split/passers_by.h"
#include "sfm_split/split/rotating_labels.h"
#include "sfm_split/split/static_labels.h"
#include "sfm_split/split/station_background.h"
#include "sfm_split/split/station_orders.h"
#include "sfm_split/split/still_keypoints.h"

namespace s2gs {
namespace {

constexpr double kMinVerifiedShare = 0.2;  // below it, pairs still further apart are not worth matching
constexpr int kMaxStaticPartners = 10;     // representatives of other stations with which one is compared
using IndexPair = std::pair<int, int>;

std::vector<int> AllOf(const ImagePairMatches& pair) {
  std::vector<int> all(pair.matches.size());
  std::iota(all.begin(), all.end(), 0);
  return all;
}

class StationSplitter {
 public:
  StationSplitter(const ScanPictures* pictures, SplitMatching* matching, MotionSplit* split)
      : matching_(*matching),
        options_(matching->settings().split),
        split_(*split),
        passers_by_(pictures, matching, &split->stations),
        orders_(split->stations, matching) {}

  void Run() {
    still_ = LabelStaticKeypoints(matching_, &split_);
    LabelPhotosOfTheirOwn(&matching_, &split_);
    PackByLabel();
    MatchBackgroundAcrossStations();
    orders_.Find([&](int i, uint32_t k) { return IsCandidate(i, k); });
    MatchObjectInsideStations();
    MatchObjectAcrossStations();
    RemoveContradicted(matching_.keypoints(), matching_.settings().motion.min_inliers, &split_.object_pairs);
    LabelRotatingKeypoints(matching_, still_.support, &split_);
  }

 private:
  void PackByLabel() {
    packed_.resize(matching_.images().size());
    packed_static_.resize(matching_.images().size());
    ParallelFor(matching_.NumImages(), 0, [&](int64_t of_image) {
      const auto i = static_cast<int>(of_image);
      const bool given = !matching_.images()[i].given_labels.empty();
      const auto pack = [&](KeypointLabel label) {
        return PackLabel(matching_.images()[i], split_.labels[i], label);
      };
      packed_[i] = pack(given ? KeypointLabel::kRotating : KeypointLabel::kUnknown);
      packed_static_[i] = pack(KeypointLabel::kStatic);
    });
  }

  // What all photos of a station share is its background; the image with most background keypoints carries
  // it.
  void MatchBackgroundAcrossStations() {
    std::vector<uint32_t> num_static;
    num_static.reserve(packed_static_.size());
    for (const PackedDescriptors& packed : packed_static_)
      num_static.push_back(static_cast<uint32_t>(packed.size()));
    const std::vector<uint32_t> representatives =
        StationRepresentatives(split_.stations.station_of_image, num_static);
    split_.representative.assign(representatives.begin(), representatives.end());
    const size_t num_stations = representatives.size();
    if (num_stations < 2) return;
    std::vector<StationBackground> backgrounds(num_stations);
    ParallelFor(static_cast<int64_t>(num_stations), 0, [&](int64_t s) {
      const auto num_photos = static_cast<double>(split_.stations.images[s].size());
      const int min_photos = std::max(1, static_cast<int>(std::ceil(kMinStaticShare * num_photos)));
      backgrounds[s] =
          MergeBackground(matching_.images(), split_.stations, split_.labels, static_cast<int>(s),
                          split_.representative[s], min_photos, matching_.settings().station.max_unmoved_px);
    });
    std::vector<uint32_t> first_row;  // of each station's features among its carrier's keypoints
    for (const StationBackground& background : backgrounds) {
      const size_t num_keypoints = matching_.images()[background.carrier].keypoints.size();
      first_row.push_back(static_cast<uint32_t>(num_keypoints));
    }
    std::vector<ImagePair> pairs;
    for (const ImagePair& pair : RepresentativePairs(representatives, kMaxStaticPartners))
      pairs.push_back(
          OrderedPair(StationOf(static_cast<int>(pair.first)), StationOf(static_cast<int>(pair.second))));
    std::sort(pairs.begin(), pairs.end());
    std::vector<BackgroundMatches> matched =
        MatchBackgrounds(backgrounds, pairs, matching_.given(), split_.stations, &matching_);
    for (size_t p = 0; p < pairs.size(); ++p) {
      const auto a = static_cast<int>(pairs[p].first);
      const auto b = static_cast<int>(pairs[p].second);
      const auto to_carriers = [&](FeatureMatches* matches) {
        for (FeatureMatch& match : *matches) {
          match.point2D_idx1 += first_row[a];
          match.point2D_idx2 += first_row[b];
        }
      };
      to_carriers(&matched[p].raw.matches);
      split_.static_matches.push_back(std::move(matched[p].raw));
      VerifiedPair& pair = matched[p].verified;
      if (pair.matches.empty()) continue;
      background_[{a, b}] = {pair.F, pair.H, pair.is_planar};
      background_[{b, a}] = {pair.F.transpose(), pair.is_planar ? Eigen::Matrix3d(pair.H.inverse()) : pair.H,
                             pair.is_planar};
      to_carriers(&pair.matches);
      split_.static_pairs.push_back(std::move(pair));
    }
    for (StationBackground& background : backgrounds) {
      StationFeatures& features = split_.station_features.emplace_back();
      features.image = background.carrier;
      features.keypoints = std::move(background.keypoints);
      features.scales = std::move(background.scales);
      features.descriptors = std::move(background.descriptors);
    }
  }

  // Steps 1, 2, 3, ... apart, then half as far again each time. Stations without a known order are matched in
  // full while that is no great work.
  void MatchObjectInsideStations() {
    rotating_.resize(matching_.images().size());
    for (int i = 0; i < matching_.NumImages(); ++i)
      rotating_[i].assign(matching_.images()[i].keypoints.size(), false);
    std::vector<ImagePair> without_order;
    for (size_t s = 0; s < orders_.order().size(); ++s) {
      if (orders_.IsByName(s)) continue;
      const std::vector<int>& station = orders_.order()[s];
      for (size_t i = 0; i < station.size(); ++i) {
        for (size_t j = 0; j < i; ++j) without_order.push_back(OrderedPair(station[i], station[j]));
      }
    }
    if (static_cast<int64_t>(without_order.size()) <= options_.max_exhaustive_pairs) {
      AddObjectPairs(NewPairs(std::move(without_order), done_), "match in stations");
      MatchBySteps();
    } else {
      MatchBySteps();
      orders_.Refine(split_.object_pairs);
      MatchBySteps();
    }
    AddObjectPairs(NewPairs(orders_.SimilarPhotos(), done_), "match similar photos");
    RemoveContradicted(matching_.keypoints(), matching_.settings().motion.min_inliers, &split_.object_pairs);
    orders_.Refine(split_.object_pairs);
    RemoveFoldedPairs(matching_, split_.stations, orders_.order(), &split_.object_pairs);
    for (const VerifiedPair& pair : split_.object_pairs) {
      for (const FeatureMatch& match : pair.matches) {
        rotating_[pair.image1][match.point2D_idx1] = true;
        rotating_[pair.image2][match.point2D_idx2] = true;
      }
    }
  }

  void MatchBySteps() {
    bool has_seen_turn = false;
    for (int step = 1;; step = step < options_.max_object_steps ? step + 1 : step + (step + 1) / 2) {
      std::vector<ImagePair> pairs;
      bool has_step = false;
      for (const std::vector<int>& station : orders_.order()) {
        const int n = static_cast<int>(station.size());
        if (2 * step > n) continue;
        has_step = true;
        for (int i = 0; i < n; ++i) pairs.push_back(OrderedPair(station[i], station[(i + step) % n]));
      }
      if (!has_step) break;
      pairs = NewPairs(std::move(pairs), done_);
      if (pairs.empty()) continue;
      const double share =
          static_cast<double>(AddObjectPairs(pairs, "match in stations")) / static_cast<double>(pairs.size());
      if (has_seen_turn && share < kMinVerifiedShare) break;
      has_seen_turn = has_seen_turn || share >= kMinVerifiedShare;
    }
  }

  bool IsCandidate(int image, uint32_t keypoint) const {
    const KeypointLabel label = split_.labels[image][keypoint];
    const bool given = !matching_.images()[image].given_labels.empty();
    return label == (given ? KeypointLabel::kRotating : KeypointLabel::kUnknown);
  }

  // Every image with its most similar ones in the other stations and those beside them, by the keypoints that
  // are known to turn.
  void MatchObjectAcrossStations() {
    const auto& stations = split_.stations.images;
    if (stations.size() < 2) return;
    std::vector<size_t> num_rotating(rotating_.size());
    for (size_t i = 0; i < rotating_.size(); ++i)
      num_rotating[i] = static_cast<size_t>(std::count(rotating_[i].begin(), rotating_[i].end(), true));
    constexpr size_t kEnough = 30;  // rotating keypoints of a photo, to compare it by these alone
    const PackedImages packed = matching_.PackLargest(kCoarseFeatures, [&](int i, uint32_t k) {
      return num_rotating[i] >= kEnough ? rotating_[i][k] : IsCandidate(i, k);
    });
    const SimilarityMatrix similarity =
        CountMatchesOfAllPairs(packed, matching_.matcher(), matching_.reporter());

    std::vector<ImagePair> pairs;
    for (size_t a = 0; a < stations.size(); ++a) {
      for (const int b : NearbyStations(static_cast<int>(a), similarity)) {
        for (const int image : stations[a]) AddPartners(image, orders_.order()[b], similarity, &pairs);
      }
    }
    AddObjectPairs(NewPairs(std::move(pairs), done_), "match across stations");
  }

  // The stations whose images have most in common with those of station `a`.
  std::vector<int> NearbyStations(int a, const SimilarityMatrix& similarity) const {
    const auto& stations = split_.stations.images;
    std::vector<std::pair<double, int>> ranked;
    for (size_t b = 0; b < stations.size(); ++b) {
      if (static_cast<int>(b) == a) continue;
      double total = 0;
      for (const int i : stations[a]) {
        uint32_t best = 0;
        for (const int j : stations[b]) best = std::max(best, similarity(i, j));
        total += best;
      }
      ranked.emplace_back(-total, static_cast<int>(b));
    }
    std::sort(ranked.begin(), ranked.end());
    ranked.resize(std::min(ranked.size(), static_cast<size_t>(options_.max_nearby_stations)));
    std::vector<int> nearby;
    nearby.reserve(ranked.size());
    for (const auto& [total, b] : ranked) nearby.push_back(b);
    return nearby;
  }

  void AddPartners(int image, const std::vector<int>& station, const SimilarityMatrix& similarity,
                   std::vector<ImagePair>* pairs) const {
    const int n = static_cast<int>(station.size());
    std::vector<int> places(n);
    std::iota(places.begin(), places.end(), 0);
    const int num = std::min(options_.station_partners, n);
    std::partial_sort(places.begin(), places.begin() + num, places.end(), [&](int x, int y) {
      const uint32_t sx = similarity(image, station[x]);
      const uint32_t sy = similarity(image, station[y]);
      return sx != sy ? sx > sy : x < y;
    });
    for (int p = 0; p < num; ++p) {
      if (similarity(image, station[places[p]]) < kMinCoarseMatches) break;
      for (int w = -1; w <= 1; ++w) pairs->push_back(OrderedPair(image, station[(places[p] + w + n) % n]));
    }
  }

  // Matches, leaves out what follows the background, fits one motion. Returns the number of pairs with one.
  int AddObjectPairs(const std::vector<ImagePair>& pairs, const char* task) {
    auto matched = matching_.Match(pairs, packed_, task);
    std::vector<std::vector<int>> subsets(matched.size());
    for (size_t p = 0; p < matched.size(); ++p) subsets[p] = MovingMatches(matched[p]);
    passers_by_.Look(matched, subsets);
    for (size_t p = 0; p < matched.size(); ++p) {
      if (passers_by_.LeaveOut(&matched[p])) subsets[p] = MovingMatches(matched[p]);
    }
    int num_verified = 0;
    for (VerifiedPair& pair : matching_.VerifyAll(matched, &subsets, "fit motions")) {
      if (pair.matches.empty()) continue;
      if (pair.log_false_alarms <= kMaxLogFalseAlarms) ++num_verified;
      split_.object_pairs.push_back(std::move(pair));
    }
    done_.insert(done_.end(), pairs.begin(), pairs.end());
    std::move(matched.begin(), matched.end(), std::back_inserter(split_.object_matches));
    return num_verified;
  }

  std::vector<int> MovingMatches(const ImagePairMatches& pair) const {
    if (!matching_.images()[pair.image1].given_labels.empty()) return AllOf(pair);
    std::vector<int> moving;
    const int a = StationOf(pair.image1);
    const int b = StationOf(pair.image2);
    const auto background = background_.find({a, b});
    for (size_t m = 0; m < pair.matches.size(); ++m) {
      const FeatureMatch& match = pair.matches[m];
      const Eigen::Vector2f& xy1 = matching_.keypoints()[pair.image1][match.point2D_idx1];
      const Eigen::Vector2f& xy2 = matching_.keypoints()[pair.image2][match.point2D_idx2];
      bool follows_background = false;
      if (a == b) {
        follows_background =
            (xy2 - split_.stations.Move(pair.image1, pair.image2, xy1)).norm() <= options_.min_moved_px;
      } else if (background != background_.end() && !rotating_[pair.image1][match.point2D_idx1] &&
                 !rotating_[pair.image2][match.point2D_idx2]) {
        // Where the table stands the same in both photos, what turns follows the background's geometry, too.
        follows_background = Follows(background->second, ToRepresentative(pair.image1, xy1),
                                     ToRepresentative(pair.image2, xy2));
      }
      if (!follows_background) moving.push_back(static_cast<int>(m));
    }
    return moving;
  }

  // How the background moves from one station to another. Stations that only turned the camera have no
  // epipolar geometry, only a homography.
  struct BackgroundMotion {
    Eigen::Matrix3d F;
    Eigen::Matrix3d H;
    bool is_planar;
  };

  // Where the station's representative, between which backgrounds were matched, would show the same ray.
  Eigen::Vector2f ToRepresentative(int image, const Eigen::Vector2f& xy) const {
    return split_.stations.Move(image, split_.representative[StationOf(image)], xy);
  }

  bool Follows(const BackgroundMotion& background, const Eigen::Vector2f& xy1,
               const Eigen::Vector2f& xy2) const {
    if (!background.is_planar)
      return SampsonErrorPx(background.F, xy1, xy2) <= matching_.settings().motion.max_error_px;
    const Eigen::Vector3d mapped = background.H * xy1.cast<double>().homogeneous();
    return (mapped.hnormalized() - xy2.cast<double>()).norm() <= options_.min_moved_px;
  }

  int StationOf(int image) const { return split_.stations.station_of_image[image]; }

  SplitMatching& matching_;
  const MotionSplitOptions& options_;
  MotionSplit& split_;
  PassersBy passers_by_;
  StationOrders orders_;
  StillSupport still_;
  PackedImages packed_;                      // what may turn
  PackedImages packed_static_;               // what stands still
  std::vector<std::vector<bool>> rotating_;  // with a verified match inside its station
  std::vector<ImagePair> done_;
  std::map<IndexPair, BackgroundMotion> background_;  // from one station to another
};

}  // namespace

void SplitByStations(const ScanPictures* pictures, SplitMatching* matching, MotionSplit* split) {
  StationSplitter(pictures, matching, split).Run();
}

}  // namespace s2gs
