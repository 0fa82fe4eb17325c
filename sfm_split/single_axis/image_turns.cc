#include "sfm_split/single_axis/image_turns.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cstddef>
#include <queue>
#include <utility>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/solvers/eigen_solvers.h"

namespace s2gs {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr double kLeastVotes = 2.5;  // two matches agree by chance

}  // namespace

ImageTurns SynchronizeTurns(const AxisRays& rays, const std::vector<TurnVote>& votes) {
  ImageTurns turns;
  const size_t num = rays.cameras.size();
  std::vector<std::vector<size_t>> edges(num);
  for (size_t p = 0; p < rays.pairs.size(); ++p) {
    if (votes[p].score < kLeastVotes) continue;
    edges[rays.pairs[p].image1].push_back(p);
    edges[rays.pairs[p].image2].push_back(p);
  }
  turns.angles.assign(num, 0);
  turns.connected.assign(num, 0);
  // The largest tree: grown from every image that is not in one yet.
  std::vector<char> seen(num, 0);
  size_t largest = 0;
  for (size_t root = 0; root < num; ++root) {
    if (seen[root] != 0) continue;
    std::vector<char> in_tree(num, 0);
    std::vector<double> angles(num, 0);
    std::priority_queue<std::pair<double, std::pair<size_t, size_t>>> queue;  // votes, (pair, new image)
    size_t size = 0;
    const auto enter = [&](size_t image) {
      in_tree[image] = seen[image] = 1;
      ++size;
      for (const size_t p : edges[image]) {
        const auto other =
            static_cast<size_t>(rays.pairs[p].image1) == image ? rays.pairs[p].image2 : rays.pairs[p].image1;
        if (in_tree[other] == 0) queue.push({votes[p].score, {p, static_cast<size_t>(other)}});
      }
    };
    enter(root);
    while (!queue.empty()) {
      const auto [p, image] = queue.top().second;
      queue.pop();
      if (in_tree[image] != 0) continue;
      angles[image] = static_cast<size_t>(rays.pairs[p].image2) == image
                          ? angles[rays.pairs[p].image1] + votes[p].angle
                          : angles[rays.pairs[p].image2] - votes[p].angle;
      enter(image);
    }
    if (size <= largest) continue;
    largest = size;
    turns.angles = angles;
    turns.connected = in_tree;
  }

  const auto n = static_cast<Eigen::Index>(num);
  for (double scale = 40 * kDegree; scale > 0.2 * kDegree; scale *= 0.7) {
    MatrixXd normal = 1e-9 * MatrixXd::Identity(n, n);
    VectorXd right = VectorXd::Zero(n);
    for (size_t p = 0; p < rays.pairs.size(); ++p) {
      const int i = rays.pairs[p].image1;
      const int j = rays.pairs[p].image2;
      if (votes[p].score < kLeastVotes || turns.connected[i] == 0 || turns.connected[j] == 0) continue;
      const double error = WrapAngle(votes[p].angle - (turns.angles[j] - turns.angles[i]));
      const double ratio = error / scale;
      const double weight = votes[p].score / ((1 + ratio * ratio) * (1 + ratio * ratio));
      normal(i, i) += weight;
      normal(j, j) += weight;
      normal(i, j) -= weight;
      normal(j, i) -= weight;
      right(j) += weight * error;
      right(i) -= weight * error;
    }
    const VectorXd step = normal.ldlt().solve(right);
    for (size_t i = 0; i < num; ++i) turns.angles[i] += step(static_cast<Eigen::Index>(i));
  }
  return turns;
}

std::vector<char> LargestConnected(const AxisRays& rays,
                                   const std::vector<std::vector<char>>& inliers_of_pair,
                                   const std::vector<char>& among) {
  std::vector<std::vector<int>> neighbours(rays.cameras.size());
  for (const RayPair& pair : rays.pairs) {
    const std::vector<char>& inliers = inliers_of_pair[pair.index];
    const auto agreeing = std::count(inliers.begin(), inliers.end(), 1);
    if (agreeing < 3) continue;
    neighbours[pair.image1].push_back(pair.image2);
    neighbours[pair.image2].push_back(pair.image1);
  }
  std::vector<char> best(rays.cameras.size(), 0);
  std::vector<char> seen(rays.cameras.size(), 0);
  std::ptrdiff_t largest = 0;
  for (size_t root = 0; root < rays.cameras.size(); ++root) {
    if (seen[root] != 0 || among[root] == 0) continue;
    std::vector<char> component(rays.cameras.size(), 0);
    std::vector<int> stack = {static_cast<int>(root)};
    seen[root] = component[root] = 1;
    while (!stack.empty()) {
      const int image = stack.back();
      stack.pop_back();
      for (const int next : neighbours[image]) {
        if (seen[next] != 0) continue;
        seen[next] = component[next] = 1;
        stack.push_back(next);
      }
    }
    const auto size = std::count(component.begin(), component.end(), 1);
    if (size <= largest) continue;
    largest = size;
    best = component;
  }
  return best;
}

}  // namespace s2gs
