#include "sfm_split/split/hand_held_split.h"

#include <algorithm>
#include <array>
#include <bitset>
#include <cmath>
#include <numeric>
#include <string>
#include <utility>

#include "sfm_split/base/parallel_for.h"
#include "sfm_split/split/motion_sync.h"
#include "sfm_split/split/pair_evidence.h"
#include "sfm_split/split/rotating_labels.h"

namespace s2gs {
namespace {

constexpr int kNeighbours = 4;          // photos before and after, as they were taken
constexpr int kSimilar = 12;            // photos that look most alike
constexpr size_t kMaxFeatures = 8192;   // of a photo: here all are matched with all
constexpr double kOwnBand = 3;          // what lies within so many bounds of a motion is no second motion
constexpr int kMinBodyKeypoints = 40;   // of an image that shows a body
constexpr double kMinBodyImages = 0.4;  // share of the images that must show both bodies
constexpr double kMaxConflicts = 0.05;  // share of the keypoints that were seen moving with both
constexpr double kMinVotes = 2;         // motions that a keypoint of a body belongs to
constexpr int kClearMajority = 3;       // votes for the one body for each vote for the other
constexpr int kGridSize = 8;            // cells along each side of a photo, that say how far a body spreads

std::vector<ImagePair> PlanPairs(const SimilarityMatrix& similarity, const Stations& stations,
                                 const MotionSplitOptions& options) {
  const auto num = static_cast<uint32_t>(similarity.rows());
  std::vector<uint32_t> order(num);
  std::iota(order.begin(), order.end(), 0U);
  const bool all = int64_t{num} * (num - 1) / 2 <= options.max_exhaustive_pairs;
  std::vector<ImagePair> pairs =
      NeighbourPairs(order, all ? static_cast<int>(num) : kNeighbours, /*wrap=*/true);
  if (!all) {
    for (const ImagePair& pair : SimilarPairs(similarity, kSimilar)) pairs.push_back(pair);
    pairs = NewPairs(std::move(pairs), {});
  }
  const auto has_no_baseline = [&](const ImagePair& pair) {
    return stations.station_of_image[pair.first] == stations.station_of_image[pair.second];
  };
  pairs.erase(std::remove_if(pairs.begin(), pairs.end(), has_no_baseline), pairs.end());
  return pairs;
}

// The motions of one pair, the strongest first, each with its own matches.
std::vector<VerifiedPair> FindMotions(const SplitMatching& matching, const ImagePairMatches& pair,
                                      int max_motions) {
  std::vector<VerifiedPair> motions;
  // Matches that stay at their pixel between photos from different places are dust, a watermark, or what
  // little stands still where everything else turns; any epipole suits them.
  std::vector<int> left;
  left.reserve(pair.matches.size());
  for (size_t m = 0; m < pair.matches.size(); ++m) {
    const Eigen::Vector2f moved = matching.keypoints()[pair.image2][pair.matches[m].point2D_idx2] -
                                  matching.keypoints()[pair.image1][pair.matches[m].point2D_idx1];
    if (moved.norm() > matching.settings().station.max_unmoved_px) left.push_back(static_cast<int>(m));
  }
  while (static_cast<int>(motions.size()) < max_motions) {
    VerifiedPair motion = matching.Verify(pair, left);
    if (motion.matches.empty() || (!motions.empty() && motion.log_false_alarms > kMaxLogFalseAlarms)) break;
    const double band = kOwnBand * matching.settings().motion.max_error_px;
    std::vector<int> rest;
    for (const int m : left) {
      const Eigen::Vector2f& xy1 = matching.keypoints()[pair.image1][pair.matches[m].point2D_idx1];
      const Eigen::Vector2f& xy2 = matching.keypoints()[pair.image2][pair.matches[m].point2D_idx2];
      if (SampsonErrorPx(motion.F, xy1, xy2) > band) rest.push_back(m);
    }
    left = std::move(rest);
    motions.push_back(std::move(motion));
  }
  return motions;
}

std::vector<VerifiedPair> FindAllMotions(const std::vector<ImagePairMatches>& matched, int max_motions,
                                         SplitMatching* matching) {
  constexpr size_t kBlock = 64;  // pairs between two looks at whether to stop
  std::vector<VerifiedPair> motions;
  std::vector<std::vector<VerifiedPair>> found(kBlock);
  for (size_t begin = 0; begin < matched.size(); begin += kBlock) {
    if (matching->reporter().StopRequested()) throw Interrupted();
    const size_t end = std::min(begin + kBlock, matched.size());
    ParallelFor(static_cast<int64_t>(end - begin), 0, [&](int64_t k) {
      found[k] = FindMotions(*matching, matched[begin + static_cast<size_t>(k)], max_motions);
    });
    for (size_t p = begin; p < end; ++p) {
      std::move(found[p - begin].begin(), found[p - begin].end(), std::back_inserter(motions));
    }
    matching->reporter().Progress("fit motions", static_cast<int64_t>(end),
                                  static_cast<int64_t>(matched.size()));
  }
  return motions;
}

// What the sorted motions say about the keypoints.
struct BodyVotes {
  std::vector<std::vector<std::array<int, 2>>> votes;  // per image, per keypoint, per body
  double conflicts = 0;                                // share of the keypoints with several votes
  std::array<double, 2> cells{};                       // mean number of grid cells that the body fills
  double images_with_both = 0;                         // share
};

// Photos between which the table happens to stand the same show both bodies move as one, so that a few votes
// for the wrong body are no conflict.
bool IsClear(const std::array<int, 2>& votes) {
  return std::min(votes[0], votes[1]) * kClearMajority <= std::max(votes[0], votes[1]);
}

BodyVotes CountVotes(const SplitMatching& matching, const std::vector<VerifiedPair>& motions,
                     const std::vector<int>& bodies) {
  BodyVotes result;
  const int num_images = matching.NumImages();
  result.votes.resize(num_images);
  for (int i = 0; i < num_images; ++i) result.votes[i].resize(matching.keypoints()[i].size(), {0, 0});
  for (size_t m = 0; m < motions.size(); ++m) {
    for (const FeatureMatch& match : motions[m].matches) {
      ++result.votes[motions[m].image1][match.point2D_idx1][bodies[m]];
      ++result.votes[motions[m].image2][match.point2D_idx2][bodies[m]];
    }
  }
  int64_t num_voted = 0;
  int64_t num_conflicts = 0;
  for (int i = 0; i < num_images; ++i) {
    std::array<int, 2> count{};
    std::array<std::bitset<kGridSize * kGridSize>, 2> cells;
    for (size_t k = 0; k < result.votes[i].size(); ++k) {
      const auto& votes = result.votes[i][k];
      if (votes[0] + votes[1] < kMinVotes) continue;
      ++num_voted;
      if (!IsClear(votes)) {
        ++num_conflicts;
        continue;
      }
      const int body = votes[0] > votes[1] ? 0 : 1;
      ++count[body];
      const Eigen::Vector2f xy = matching.keypoints()[i][k].cwiseQuotient(matching.sizes()[i].cast<float>());
      const Eigen::Vector2i cell =
          (xy * static_cast<float>(kGridSize)).cast<int>().cwiseMax(0).cwiseMin(kGridSize - 1);
      cells[body].set(static_cast<size_t>(cell.y()) * kGridSize + cell.x());
    }
    for (int body = 0; body < 2; ++body)
      result.cells[body] += static_cast<double>(cells[body].count()) / num_images;
    if (count[0] >= kMinBodyKeypoints && count[1] >= kMinBodyKeypoints)
      result.images_with_both += 1.0 / num_images;
  }
  result.conflicts = num_voted == 0 ? 0 : static_cast<double>(num_conflicts) / static_cast<double>(num_voted);
  return result;
}

std::string Percent(double share) { return std::to_string(std::lround(100 * share)) + " %"; }

void BecomeOneBody(const SplitMatching& matching, std::vector<VerifiedPair> strongest, MotionSplit* split) {
  split->capture_case = CaptureCase::kOneBody;
  split->object_pairs = std::move(strongest);
  RemoveContradicted(matching.keypoints(), matching.settings().motion.min_inliers, &split->object_pairs);
  split->labels.resize(matching.images().size());
  for (size_t i = 0; i < split->labels.size(); ++i)
    split->labels[i].assign(matching.images()[i].keypoints.size(), KeypointLabel::kUnknown);
  for (const VerifiedPair& pair : split->object_pairs) {
    for (const FeatureMatch& match : pair.matches) {
      split->labels[pair.image1][match.point2D_idx1] = KeypointLabel::kRotating;
      split->labels[pair.image2][match.point2D_idx2] = KeypointLabel::kRotating;
    }
  }
  for (const std::vector<int>& station : split->stations.images)
    split->representative.push_back(station.front());
}

// Every photo becomes a station and stands for itself.
void BecomeTwoBodies(const SplitMatching& matching, const std::vector<VerifiedPair>& motions,
                     const std::vector<int>& bodies, int background, const BodyVotes& votes,
                     MotionSplit* split) {
  split->capture_case = CaptureCase::kTurntable;
  const int num_images = matching.NumImages();
  split->labels.resize(num_images);
  for (int i = 0; i < num_images; ++i) {
    split->labels[i].assign(votes.votes[i].size(), KeypointLabel::kUnknown);
    for (size_t k = 0; k < votes.votes[i].size(); ++k) {
      const auto& of_body = votes.votes[i][k];
      if (of_body[background] >= kMinVotes && of_body[background] > of_body[1 - background] &&
          IsClear(of_body))
        split->labels[i][k] = KeypointLabel::kStatic;
    }
  }
  for (size_t m = 0; m < motions.size(); ++m) {
    (bodies[m] == background ? split->static_pairs : split->object_pairs).push_back(motions[m]);
  }
  const int min_inliers = matching.settings().motion.min_inliers;
  RemoveContradicted(matching.keypoints(), min_inliers, &split->static_pairs);
  RemoveContradicted(matching.keypoints(), min_inliers, &split->object_pairs);
  std::vector<std::vector<int>> against(num_images);
  for (int i = 0; i < num_images; ++i) {
    against[i].reserve(votes.votes[i].size());
    for (const auto& of_body : votes.votes[i]) against[i].push_back(kClearMajority * of_body[background]);
  }
  LabelRotatingKeypoints(matching, against, split);
  for (VerifiedPair& pair : split->static_pairs) {
    FeatureMatches left;
    left.reserve(pair.matches.size());
    for (const FeatureMatch& match : pair.matches) {
      if (split->labels[pair.image1][match.point2D_idx1] != KeypointLabel::kRotating &&
          split->labels[pair.image2][match.point2D_idx2] != KeypointLabel::kRotating)
        left.push_back(match);
    }
    pair.matches = std::move(left);
  }

  split->stations.station_of_image.resize(num_images);
  split->stations.images.assign(num_images, {});
  split->stations.shift.assign(num_images, Eigen::Vector2f::Zero());
  split->stations.photo_from_first.clear();
  for (int i = 0; i < num_images; ++i) {
    split->stations.station_of_image[i] = i;
    split->stations.images[i] = {i};
    split->representative.push_back(i);
  }
}

}  // namespace

void SplitWithoutStations(const SimilarityMatrix& similarity, bool expect_one_body, SplitMatching* matching,
                          MotionSplit* split) {
  const SplitSettings& settings = matching->settings();
  const std::vector<ImagePair> pairs = PlanPairs(similarity, split->stations, settings.split);
  split->object_matches = matching->Match(
      pairs, matching->PackLargest(kMaxFeatures, [](int, uint32_t) { return true; }), "match photos");
  const std::vector<VerifiedPair> motions =
      FindAllMotions(split->object_matches, expect_one_body ? 1 : settings.motion.max_motions, matching);
  std::vector<VerifiedPair> strongest;
  for (size_t m = 0; m < motions.size(); ++m) {
    if (m == 0 || motions[m].image1 != motions[m - 1].image1 || motions[m].image2 != motions[m - 1].image2)
      strongest.push_back(motions[m]);
  }
  if (expect_one_body) return BecomeOneBody(*matching, std::move(strongest), split);

  const std::vector<int> bodies = SortIntoBodies(matching->keypoints(), motions);
  const BodyVotes votes = CountVotes(*matching, motions, bodies);
  const std::string measured = Percent(votes.images_with_both) + " of the photos show two motions, " +
                               Percent(votes.conflicts) + " of the keypoints move with both";
  if (votes.images_with_both < kMinBodyImages || votes.conflicts > kMaxConflicts) {
    split->reason =
        "no two photos were taken from one camera position, and no second body shows apart from the "
        "first: " +
        measured + ". What can be matched is taken for one body";
    return BecomeOneBody(*matching, std::move(strongest), split);
  }
  // The background reaches further over the photos than what stands on the table.
  const int background = votes.cells[0] >= votes.cells[1] ? 0 : 1;
  split->reason = "no two photos were taken from one camera position, but two bodies move apart: " + measured;
  split->static_matches = split->object_matches;
  BecomeTwoBodies(*matching, motions, bodies, background, votes, split);
}

}  // namespace s2gs
