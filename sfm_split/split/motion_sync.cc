#include "sfm_split/split/motion_sync.h"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "sfm_split/scene/keypoint_numbers.h"

namespace s2gs {
namespace {

constexpr int kMaxIterations = 3000;  // a long chain of photos converges slowly
constexpr int kMaxSweeps = 50;        // over all motions, until no side changes: a few are usual

// The signed graph as a linear map. Shared keypoints are not expanded into edges: a keypoint seen by d
// motions ties them to their mean with weight 1.
class MotionGraph {
 public:
  MotionGraph(const std::vector<Keypoints>& keypoints, const std::vector<VerifiedPair>& motions) {
    KeypointNumbers numbers;
    for (const Keypoints& of_image : keypoints) numbers.Add(of_image.size());
    degree_of_keypoint_.assign(numbers.Count(), 0);
    keypoints_of_motion_.resize(motions.size());
    rivals_.resize(motions.size());
    for (size_t m = 0; m < motions.size(); ++m) {
      const VerifiedPair& motion = motions[m];
      keypoints_of_motion_[m].reserve(2 * motion.matches.size());
      for (const FeatureMatch& match : motion.matches) {
        keypoints_of_motion_[m].push_back(numbers.Of(motion.image1, match.point2D_idx1));
        keypoints_of_motion_[m].push_back(numbers.Of(motion.image2, match.point2D_idx2));
      }
      for (const size_t k : keypoints_of_motion_[m]) ++degree_of_keypoint_[k];
      for (size_t other = m; other-- > 0;) {
        if (motions[other].image1 != motion.image1 || motions[other].image2 != motion.image2) break;
        const double weight =
            2.0 * static_cast<double>(std::min(motion.matches.size(), motions[other].matches.size()));
        rivals_[m].push_back({other, weight});
        rivals_[other].push_back({m, weight});
      }
    }
  }

  size_t size() const { return keypoints_of_motion_.size(); }

  double Degree(size_t motion) const {
    auto degree = static_cast<double>(keypoints_of_motion_[motion].size());
    for (const Rival& rival : rivals_[motion]) degree += rival.weight;
    return degree;
  }

  // How much speaks for the motion's being on the side of the others.
  std::vector<double> Apply(const std::vector<double>& side) const {
    std::vector<double> sum(degree_of_keypoint_.size(), 0.0);
    for (size_t m = 0; m < size(); ++m) AddToKeypoints(m, side[m], &sum);
    std::vector<double> result(size());
    for (size_t m = 0; m < size(); ++m) result[m] = Pull(m, side, sum);
    return result;
  }

  // Single motions change sides until none is better off.
  void Refine(std::vector<double>* side) const {
    std::vector<double> sum(degree_of_keypoint_.size(), 0.0);
    for (size_t m = 0; m < size(); ++m) AddToKeypoints(m, (*side)[m], &sum);
    for (int sweep = 0; sweep < kMaxSweeps; ++sweep) {
      bool has_changed = false;
      for (size_t m = 0; m < size(); ++m) {
        // Its own share of the sums does not count.
        double own = 0.0;
        for (const size_t k : keypoints_of_motion_[m]) own += (*side)[m] / degree_of_keypoint_[k];
        const double pull = Pull(m, *side, sum) - own;
        if (pull * (*side)[m] >= 0.0) continue;
        AddToKeypoints(m, -2.0 * (*side)[m], &sum);
        (*side)[m] = -(*side)[m];
        has_changed = true;
      }
      if (!has_changed) break;
    }
  }

 private:
  struct Rival {
    size_t motion;
    double weight;
  };

  void AddToKeypoints(size_t motion, double value, std::vector<double>* sum) const {
    for (const size_t k : keypoints_of_motion_[motion]) (*sum)[k] += value;
  }
  double Pull(size_t motion, const std::vector<double>& side, const std::vector<double>& sum) const {
    double pull = 0.0;
    for (const size_t k : keypoints_of_motion_[motion]) pull += sum[k] / degree_of_keypoint_[k];
    for (const Rival& rival : rivals_[motion]) pull -= rival.weight * side[rival.motion];
    return pull;
  }

  std::vector<int> degree_of_keypoint_;
  std::vector<std::vector<size_t>> keypoints_of_motion_;
  std::vector<std::vector<Rival>> rivals_;
};

}  // namespace

std::vector<int> SortIntoBodies(const std::vector<Keypoints>& keypoints,
                                const std::vector<VerifiedPair>& motions) {
  const MotionGraph graph(keypoints, motions);
  const size_t num = motions.size();
  // A start that is already nearly right: the strongest motion of every pair against the others.
  std::vector<double> vector(num);
  std::vector<double> scale(num);
  for (size_t m = 0; m < num; ++m) {
    const bool is_first =
        m == 0 || motions[m - 1].image1 != motions[m].image1 || motions[m - 1].image2 != motions[m].image2;
    scale[m] = 1.0 / std::sqrt(std::max(graph.Degree(m), 1.0));
    vector[m] = (is_first ? 1.0 : -1.0) / scale[m];
  }
  std::vector<double> scaled(num);
  for (int iteration = 0; iteration < kMaxIterations; ++iteration) {
    for (size_t m = 0; m < num; ++m) scaled[m] = scale[m] * vector[m];
    const std::vector<double> applied = graph.Apply(scaled);
    double norm = 0.0;
    for (size_t m = 0; m < num; ++m) {
      // Plus the identity, which makes the largest eigenvalue the one of largest magnitude.
      vector[m] += scale[m] * applied[m];
      norm += vector[m] * vector[m];
    }
    norm = std::sqrt(std::max(norm, 1e-300));
    for (double& value : vector) value /= norm;
  }
  std::vector<double> side(num);
  for (size_t m = 0; m < num; ++m) side[m] = vector[m] >= 0.0 ? 1.0 : -1.0;
  graph.Refine(&side);

  double balance = 0.0;
  for (size_t m = 0; m < num; ++m) balance += side[m] * static_cast<double>(motions[m].matches.size());
  std::vector<int> bodies(num);
  for (size_t m = 0; m < num; ++m) bodies[m] = (side[m] > 0.0) == (balance >= 0.0) ? 0 : 1;
  return bodies;
}

}  // namespace s2gs
