#include "sfm_split/split/pair_evidence.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>

#include "sfm_split/base/parallel_for.h"
#include "sfm_split/scene/keypoint_numbers.h"

namespace s2gs {
namespace {

constexpr int kMinimalSample = 7;           // matches that fix a fundamental matrix
constexpr int kPasses = 3;                  // of removal; two were enough on every scene tried
constexpr float kSamePlacePx = 2.5F;        // SIFT gives one place several keypoints, of several orientations
constexpr double kMinConfirmedShare = 0.6;  // of the matches that third images judge
constexpr int kMinWitnessed = 8;            // confirmed matches that make up for a fit that chance explains

double LogChoose(int n, int k) {
  return (std::lgamma(n + 1.0) - std::lgamma(k + 1.0) - std::lgamma(n - k + 1.0)) / std::log(10.0);
}

// The matches of every keypoint: (image, keypoint) of the other end, keypoints numbered over all images.
class MatchGraph {
 public:
  struct End {
    int image;
    uint32_t keypoint;
  };

  MatchGraph(const std::vector<Keypoints>& keypoints, const std::vector<VerifiedPair>& pairs) {
    for (const Keypoints& of_image : keypoints) numbers_.Add(of_image.size());
    begin_.assign(numbers_.Count() + 1, 0);
    for (const VerifiedPair& pair : pairs) {
      for (const FeatureMatch& match : pair.matches) {
        ++begin_[Index(pair.image1, match.point2D_idx1) + 1];
        ++begin_[Index(pair.image2, match.point2D_idx2) + 1];
      }
    }
    for (size_t i = 1; i < begin_.size(); ++i) begin_[i] += begin_[i - 1];
    ends_.resize(begin_.back());
    std::vector<size_t> next(begin_.begin(), begin_.end() - 1);
    for (const VerifiedPair& pair : pairs) {
      for (const FeatureMatch& match : pair.matches) {
        ends_[next[Index(pair.image1, match.point2D_idx1)]++] = {pair.image2, match.point2D_idx2};
        ends_[next[Index(pair.image2, match.point2D_idx2)]++] = {pair.image1, match.point2D_idx1};
      }
    }
  }

  const End* begin(int image, uint32_t keypoint) const {
    return ends_.data() + begin_[Index(image, keypoint)];
  }
  const End* end(int image, uint32_t keypoint) const {
    return ends_.data() + begin_[Index(image, keypoint) + 1];
  }

 private:
  size_t Index(int image, uint32_t keypoint) const { return numbers_.Of(image, keypoint); }

  KeypointNumbers numbers_;
  std::vector<size_t> begin_;
  std::vector<End> ends_;
};

bool IsKept(const VerifiedPair& pair, const PairSupport& support) {
  const int judged = support.num_confirmed + support.num_contradicted;
  const bool agrees = support.num_confirmed >= kMinConfirmedShare * judged;
  const bool is_witnessed = support.num_confirmed >= kMinWitnessed;
  return agrees && (is_witnessed || pair.log_false_alarms <= kMaxLogFalseAlarms);
}

}  // namespace

double LogFalseAlarms(int num_inliers, int num_matches, double inlier_probability) {
  if (num_inliers <= kMinimalSample) return 0.0;
  return std::log10(static_cast<double>(num_matches - kMinimalSample)) + LogChoose(num_matches, num_inliers) +
         LogChoose(num_inliers, kMinimalSample) +
         (num_inliers - kMinimalSample) * std::log10(inlier_probability);
}

double EpipolarInlierProbability(const Keypoints& keypoints1, const Keypoints& keypoints2,
                                 const FeatureMatches& matches, const std::vector<int>& subset,
                                 double max_error_px) {
  Eigen::AlignedBox<float, 2> box1;
  Eigen::AlignedBox<float, 2> box2;
  for (const int m : subset) {
    box1.extend(keypoints1[matches[m].point2D_idx1]);
    box2.extend(keypoints2[matches[m].point2D_idx2]);
  }
  double largest = 1e-6;
  for (const auto& box : {box1, box2}) {
    if (box.isEmpty()) continue;
    const Eigen::Vector2d sides = box.sizes().cast<double>().cwiseMax(1.0);
    // Sampson's error is the distance from the line over the square root of 2.
    const double band = 2.0 * std::sqrt(2.0) * max_error_px * sides.norm();
    largest = std::max(largest, band / (sides.x() * sides.y()));
  }
  return std::min(1.0, largest);
}

std::vector<PairSupport> FindPairSupport(const std::vector<Keypoints>& keypoints,
                                         const std::vector<VerifiedPair>& pairs) {
  const MatchGraph graph(keypoints, pairs);
  std::vector<PairSupport> supports(pairs.size());
  // Per image: the keypoint that the match's first end goes to, and for which match that was noted.
  struct Notes {
    std::vector<uint32_t> seen;
    std::vector<int64_t> noted;
    int64_t stamp = 0;
  };
  std::vector<Notes> notes_of_thread(NumThreadsOf(0));
  for (Notes& notes : notes_of_thread) {
    notes.seen.assign(keypoints.size(), 0);
    notes.noted.assign(keypoints.size(), -1);
  }
  ParallelFor(static_cast<int64_t>(pairs.size()), 0, 16, [&](int64_t p) {
    auto& [seen, noted, stamp] = notes_of_thread[LoopThread()];
    const VerifiedPair& pair = pairs[p];
    PairSupport& support = supports[p];
    support.balance.reserve(pair.matches.size());
    for (const FeatureMatch& match : pair.matches) {
      ++stamp;
      for (const auto* end = graph.begin(pair.image1, match.point2D_idx1);
           end != graph.end(pair.image1, match.point2D_idx1); ++end) {
        if (end->image == pair.image2) continue;
        seen[end->image] = end->keypoint;
        noted[end->image] = stamp;
      }
      int balance = 0;
      for (const auto* end = graph.begin(pair.image2, match.point2D_idx2);
           end != graph.end(pair.image2, match.point2D_idx2); ++end) {
        if (end->image == pair.image1 || noted[end->image] != stamp) continue;
        const Keypoints& third = keypoints[end->image];
        balance += (third[end->keypoint] - third[seen[end->image]]).norm() <= kSamePlacePx ? 1 : -1;
      }
      support.balance.push_back(balance);
      if (balance > 0) ++support.num_confirmed;
      if (balance < 0) ++support.num_contradicted;
    }
  });
  return supports;
}

void RemoveContradicted(const std::vector<Keypoints>& keypoints, int min_inliers,
                        std::vector<VerifiedPair>* pairs) {
  for (int pass = 0; pass < kPasses; ++pass) {
    const std::vector<PairSupport> supports = FindPairSupport(keypoints, *pairs);
    std::vector<VerifiedPair> kept;
    kept.reserve(pairs->size());
    bool has_changed = false;
    for (size_t p = 0; p < pairs->size(); ++p) {
      VerifiedPair& pair = (*pairs)[p];
      if (!IsKept(pair, supports[p])) {
        has_changed = true;
        continue;
      }
      if (supports[p].num_contradicted > 0) {
        has_changed = true;
        FeatureMatches left;
        left.reserve(pair.matches.size());
        for (size_t m = 0; m < pair.matches.size(); ++m) {
          if (supports[p].balance[m] >= 0) left.push_back(pair.matches[m]);
        }
        pair.matches = std::move(left);
      }
      if (static_cast<int>(pair.matches.size()) >= min_inliers) kept.push_back(std::move(pair));
    }
    *pairs = std::move(kept);
    if (!has_changed) break;
  }
}

}  // namespace s2gs
